//! The port of a reader, compiled once for all channels.

use std::ptr;
use std::rc::Rc;
use std::sync::Arc;

use iceoryx2::port::subscriber::{Subscriber, SubscriberCreateError};
use iceoryx2::prelude::CallbackProgression;
use iceoryx2::sample::Sample as Borrowed;
use iceoryx2::service::marker::{CustomHeaderMarker, CustomPayloadMarker};
use iceoryx2::service::port_factory::PortFactory as _;
use joulebus_wire::Flow;

use super::degradation::Failures;
use super::places::{OpenPlaces, Places};
use super::repair::Repair;
use super::service::{self, Factory, FrameTypes, OpenError};
use crate::ipc::Ipc;
use crate::liveness::guarded::{DropsHere, Guarded};
use crate::liveness::worker_ports::WorkerPorts;
use crate::membership::Membership;
use crate::{Bus, FilesRemoved, Limits, clock};

/// Maximum number of frames of other processes than the worker that one call skips.
const MAX_PASSED_OVER: u32 = 4_096;

type Port = Subscriber<Ipc, [CustomPayloadMarker], CustomHeaderMarker>;

type Sample = Borrowed<Ipc, [CustomPayloadMarker], CustomHeaderMarker>;

/// A port that lends frames.
#[derive(Debug)]
struct Lender {
    // Dropped in this order.
    port: Guarded<Port>,
    _member: Member,
}

/// A frame that was received. It owns the port that received it: iceoryx2 takes all that a dropped
/// port has borrowed for returned, and the sender overwrites it.
#[derive(Debug)]
pub(super) struct InFrame {
    // Dropped in this order.
    sample: DropsHere<Sample>,
    _lender: Rc<Lender>,
}

impl InFrame {
    /// Address of its header. A reference to a value of size 0 leads to no memory behind it, so the
    /// pointer is made anew: iceoryx2 exposes that to its memory.
    pub(super) fn header(&self) -> *const CustomHeaderMarker {
        ptr::with_exposed_provenance(ptr::from_ref(self.sample.user_header()).addr())
    }

    pub(super) fn bytes(&self) -> *const [CustomPayloadMarker] {
        self.sample.payload()
    }

    /// The port that sent it.
    pub(super) fn writer(&self) -> u128 {
        self.sample.header().publisher_id().value()
    }
}

/// Membership that keeps the domain as long as a frame.
pub(super) type Member = Rc<Membership>;

/// Receives frames of one channel. On the worker's channels, only those of the holder of the
/// worker's lock.
#[derive(Debug)]
pub(super) struct Inlet {
    // Dropped in this order: port, factory, membership. Frames may keep the port for longer.
    lender: Rc<Lender>,
    factory: Guarded<Factory>,
    buffer: usize,
    /// Frames that can be queued at once, of all writers.
    queued: usize,
    failures: Arc<Failures>,
    repair: Repair,
    /// None for services on which every process may send.
    worker: Option<WorkerPorts>,
    member: Member,
}

impl Inlet {
    pub(super) fn open(bus: &Bus, limits: &Limits, types: &FrameTypes) -> Result<Self, OpenError> {
        let (service, shape) = (types.service, limits.shape(types.flow));
        let factory = service::open(bus, limits, types)?;
        let failures = Failures::new();
        let nodes = || {
            let mut nodes = Vec::new();
            factory.dynamic_config().list_subscribers(|reader| {
                nodes.push(reader.node_id);
                CallbackProgression::Continue
            });
            nodes
        };
        let open = OpenPlaces::new(limits, types.flow);
        let places = Places { bus, service, open: Some(open), nodes };
        let subscriber = places.create(
            || subscribe(&factory, shape.buffer, &failures),
            SubscriberCreateError::ExceedsMaxSupportedSubscribers,
        )?;
        // A failed connection is only counted, above.
        service::check_shortage()?;
        let need = service::need(&bus.member, &factory, None);
        Ok(Self {
            lender: lender(subscriber, &factory, &bus.member),
            factory: Guarded::new(factory, need),
            buffer: shape.buffer,
            queued: shape.buffer * shape.publishers,
            failures,
            repair: Repair::default(),
            worker: (types.flow != Flow::Sources).then(|| WorkerPorts::new(bus.domain())),
            member: Rc::clone(&bus.member),
        })
    }

    /// Number of failed or broken connections to writers.
    pub(super) fn degraded(&self) -> u64 {
        self.failures.count()
    }

    /// Frames that can be queued at once, of all writers.
    pub(super) const fn queued(&self) -> usize {
        self.queued
    }

    /// None for services on which every process may send.
    pub(super) const fn member(&self) -> &Member {
        &self.member
    }

    pub(super) const fn worker(&self) -> Option<&WorkerPorts> {
        self.worker.as_ref()
    }

    /// A writer that dies while its connection is established leaves a failed connection, which is
    /// not an error: only one to a writer that is still there three seconds later is.
    pub(super) fn receive(&mut self) -> Result<Option<InFrame>, ReceiveError> {
        self.member.presence.check()?;
        let mut passed_over = 0;
        loop {
            let received = self
                .lender
                .port
                .receive()
                .map_err(|reason| ReceiveError::Receive { reason: reason.to_string() })?;
            if let Some(frame) = received {
                let worker = self.worker.as_mut();
                if worker.is_none_or(|worker| worker.admits(frame.origin().value())) {
                    let lender = Rc::clone(&self.lender);
                    return Ok(Some(InFrame { sample: DropsHere::new(frame), _lender: lender }));
                }
                passed_over += 1;
                // A process that sends without end must not block the reader.
                if passed_over == MAX_PASSED_OVER {
                    return Ok(None);
                }
                continue;
            }
            if !self.is_retry_due() {
                return Ok(None);
            }
            self.reconnect()?;
        }
    }

    fn is_retry_due(&mut self) -> bool {
        let is_listed = || {
            self.failures.are_listed(|each| {
                self.factory.dynamic_config().list_publishers(|writer| {
                    each(writer.publisher_id.value());
                    CallbackProgression::Continue
                });
            })
        };
        self.repair.is_due(self.failures.count(), clock::monotonic_ns, is_listed)
    }

    /// iceoryx2 does not retry a failed connection. A new port does. The old one is empty, and is
    /// kept if the new one fails to connect as well: it may have less. Frames that it has lent keep
    /// it, and its place, until they are dropped.
    fn reconnect(&mut self) -> Result<(), ReceiveError> {
        self.member.presence.look()?;
        let before = self.failures.count();
        let created = subscribe(&self.factory, self.buffer, &self.failures);
        let connections = self.failures.count();
        let is_whole = created.is_ok() && connections == before;
        self.repair.retried(connections, is_whole);
        if !is_whole {
            return Err(ReceiveError::Degraded { connections });
        }
        let port =
            created.map_err(|reason| ReceiveError::Receive { reason: reason.to_string() })?;
        self.lender = lender(port, &self.factory, &self.member);
        self.failures.forget();
        Ok(())
    }
}

fn lender(port: Port, factory: &Factory, member: &Member) -> Rc<Lender> {
    let need = service::need(member, factory, None);
    Rc::new(Lender { port: Guarded::new(port, need), _member: Rc::clone(member) })
}

fn subscribe(
    factory: &Factory,
    buffer: usize,
    failures: &Arc<Failures>,
) -> Result<Port, SubscriberCreateError> {
    factory
        .subscriber_builder()
        .buffer_size(buffer)
        .set_degradation_handler(failures.handler(|info| info.sender_port_id))
        .create()
}

/// Reason that no frame could be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum ReceiveError {
    /// Files of this process were removed: every further call fails as well.
    #[error(transparent)]
    Removed(#[from] FilesRemoved),
    /// The connection to a writer has failed for three seconds or more. Its frames are missing. It
    /// is retried every three seconds. A writer that died in the meantime is not an error.
    #[error(
        "{connections} connections to writers failed so far. Are there file descriptors left \
         (`ulimit -n`), and shared memory? `joulebus doctor` tells"
    )]
    Degraded { connections: u64 },
    /// iceoryx2 returned an error.
    #[error("cannot receive: {reason}")]
    Receive { reason: String },
}
