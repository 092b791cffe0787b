//! Reads frames in place.

use std::marker::PhantomData;
use std::rc::Rc;
use std::sync::Arc;

use iceoryx2::port::subscriber::{Subscriber, SubscriberCreateError};
use iceoryx2::prelude::CallbackProgression;
use iceoryx2::sample::Sample as Borrowed;
use iceoryx2::service::port_factory::PortFactory as _;
use joulebus_wire::{Channel, Flow};

use super::degradation::Failures;
use super::places::{Open, Places};
use super::repair::Repair;
use super::service::{self, Factory, OpenError};
use crate::bus::OWN;
use crate::ipc::Ipc;
use crate::liveness::kept::Kept;
use crate::liveness::worker_ports::WorkerPorts;
use crate::membership::Membership;
use crate::{Bus, FilesRemoved, Limits, clock};

/// Maximum number of frames of other processes than the worker that one call skips.
const MAX_PASSED_OVER: u32 = 4_096;

type Port<C> = (Inlet<C>, Factory<C>);
/// The port itself.
type Inlet<C> = Subscriber<Ipc, [<C as Channel>::Row], <C as Channel>::Header>;
type Received<C> = Borrowed<Ipc, [<C as Channel>::Row], <C as Channel>::Header>;

/// Reads frames in place. On the worker's channels, only those of the holder of the worker's lock.
#[derive(Debug)]
pub struct Reader<C: Channel> {
    // Dropped in this order: held frame, port, factory, membership.
    held: Option<Received<C>>,
    port: Kept<Port<C>>,
    buffer: usize,
    /// Frames that can be queued at once, of all writers.
    queued: usize,
    failures: Arc<Failures>,
    repair: Repair,
    /// None for services on which every process may send.
    worker: Option<WorkerPorts>,
    member: Rc<Membership>,
}

impl<C: Channel> Reader<C> {
    pub(super) fn open(bus: &Bus, limits: &Limits) -> Result<Self, OpenError> {
        let (service, shape) = (C::SERVICE, limits.shape(C::FLOW));
        let factory = service::open::<C>(bus, limits)?;
        let failures = Failures::new();
        let is_full =
            |error: &_| matches!(error, SubscriberCreateError::ExceedsMaxSupportedSubscribers);
        let nodes = || {
            let mut nodes = Vec::new();
            factory.dynamic_config().list_subscribers(|reader| {
                nodes.push(reader.node_id);
                CallbackProgression::Continue
            });
            nodes
        };
        let open = Open { places: limits.open_places(C::FLOW), own: OWN };
        let places = Places { bus, service, open: Some(open), nodes };
        let create = || {
            places.enter(
                || subscribe::<C>(&factory, shape.buffer, &failures),
                || SubscriberCreateError::ExceedsMaxSupportedSubscribers,
            )
        };
        let subscriber =
            service::create(bus, create, is_full).map_err(|reason| match is_full(&reason) {
                true => places.refused(reason),
                false => OpenError::port(service, reason),
            })?;
        // A failed connection is only counted, above.
        service::check_shortage()?;
        let need = service::need(bus, &factory, None);
        Ok(Self {
            held: None,
            port: Kept::new((subscriber, factory), need),
            buffer: shape.buffer,
            queued: shape.buffer * shape.publishers,
            failures,
            repair: Repair::default(),
            worker: (C::FLOW != Flow::Sources).then(|| WorkerPorts::new(bus.domain())),
            member: Rc::clone(&bus.member),
        })
    }

    /// The oldest queued frame. `None` if the queue is empty. Overwritten frames are detected by
    /// the numbers in the headers.
    ///
    /// # Errors
    /// [`ReceiveError`]. The next call may succeed.
    pub fn take_next(&mut self) -> Result<Option<Frame<'_, C>>, ReceiveError> {
        Ok(self.receive()?.map(Frame::new))
    }

    /// Calls `each` for all queued frames, in order: as many as can be queued at once, so that
    /// faster writers do not keep the caller for ever.
    ///
    /// # Errors
    /// [`ReceiveError`]. The next call may succeed.
    pub fn take_all(
        &mut self,
        mut each: impl FnMut(&C::Header, &[C::Row]),
    ) -> Result<(), ReceiveError> {
        for _ in 0..self.queued {
            let Some(frame) = self.receive()? else {
                break;
            };
            each(frame.user_header(), frame.payload());
        }
        Ok(())
    }

    /// The newest frame, skipping older ones. `None` if there is no new one since the last call.
    ///
    /// # Errors
    /// [`ReceiveError`]. The next call may succeed.
    pub fn take_latest(&mut self) -> Result<Option<Frame<'_, C>>, ReceiveError> {
        let mut latest = None;
        while let Some(newer) = self.receive()? {
            latest = Some(newer);
        }
        Ok(latest.map(Frame::new))
    }

    /// Receives all queued frames and holds the last one that is `newer` than the held one. Returns
    /// whether there was one. `newer` is also passed the number of the worker's run of the frame,
    /// which increases whenever another process has become the worker. The frame is held in shared
    /// memory until a newer one is held or the reader is dropped: [`Reader::held`]. Must not be
    /// combined with the other methods of receiving.
    ///
    /// # Errors
    /// [`ReceiveError`] if nothing newer was found. The next call may succeed.
    pub fn hold_latest(
        &mut self,
        mut newer: impl FnMut(&C::Header, &[C::Row], u64) -> bool,
    ) -> Result<bool, ReceiveError> {
        let mut found = false;
        loop {
            match self.receive() {
                Ok(Some(frame))
                    if newer(frame.user_header(), frame.payload(), self.worker_runs()) =>
                {
                    self.held = Some(frame);
                    found = true;
                }
                Ok(Some(_)) => {}
                Ok(None) => return Ok(found),
                Err(_) if found => return Ok(true),
                Err(error) => return Err(error),
            }
        }
    }

    /// The frame held by [`Reader::hold_latest`]: its header and its slice. Its writer could still
    /// change it (it does not): copy it where that matters.
    #[must_use]
    pub fn held(&self) -> Option<(&C::Header, &[C::Row])> {
        let held = self.held.as_ref()?;
        Some((held.user_header(), held.payload()))
    }

    /// Moves the frame of [`Reader::held`] out of the reader, to keep it for longer. A process can
    /// keep two frames of forecasts beside the newest. With more, receiving is an error.
    #[must_use]
    pub fn take_held(&mut self) -> Option<KeptFrame<C>> {
        let frame = self.held.take()?;
        Some(KeptFrame { frame, _member: Rc::clone(&self.member) })
    }

    /// Number of failed or broken connections to writers.
    #[must_use]
    pub fn degraded(&self) -> u64 {
        self.failures.count()
    }

    /// Number of skipped frames on a service of the worker that another process has sent.
    #[must_use]
    pub fn foreign(&self) -> u64 {
        self.worker.as_ref().map_or(0, WorkerPorts::foreign)
    }

    fn worker_runs(&self) -> u64 {
        self.worker.as_ref().map_or(0, WorkerPorts::runs)
    }

    /// A writer that dies while its connection is established leaves a failed connection, which is
    /// not an error: only one to a writer that is still there three seconds later is.
    pub(super) fn receive(&mut self) -> Result<Option<Received<C>>, ReceiveError> {
        self.member.presence.check()?;
        let mut passed_over = 0;
        loop {
            let received = self
                .port
                .0
                .receive()
                .map_err(|reason| ReceiveError::Receive { reason: reason.to_string() })?;
            if let Some(frame) = received {
                let worker = self.worker.as_mut();
                if worker.is_none_or(|worker| worker.admits(frame.origin().value())) {
                    return Ok(Some(frame));
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
                self.port.1.dynamic_config().list_publishers(|writer| {
                    each(writer.publisher_id.value());
                    CallbackProgression::Continue
                });
            })
        };
        self.repair.is_due(self.failures.count(), clock::monotonic_ns, is_listed)
    }

    /// iceoryx2 does not retry a failed connection. A new port does. The old one is empty, and is
    /// kept if the new one fails to connect as well: it may have less.
    fn reconnect(&mut self) -> Result<(), ReceiveError> {
        self.member.presence.look()?;
        let before = self.failures.count();
        let created = subscribe::<C>(&self.port.1, self.buffer, &self.failures);
        let connections = self.failures.count();
        let is_whole = created.is_ok() && connections == before;
        self.repair.retried(connections, is_whole);
        if !is_whole {
            return Err(ReceiveError::Degraded { connections });
        }
        self.port.0 =
            created.map_err(|reason| ReceiveError::Receive { reason: reason.to_string() })?;
        self.failures.forget();
        Ok(())
    }
}

fn subscribe<C: Channel>(
    factory: &Factory<C>,
    buffer: usize,
    failures: &Arc<Failures>,
) -> Result<Inlet<C>, SubscriberCreateError> {
    factory
        .subscriber_builder()
        .buffer_size(buffer)
        .set_degradation_handler(failures.handler(|info| info.sender_port_id))
        .create()
}

/// A frame in shared memory, held while this value lives.
///
/// Its writer could still change it (it does not): copy it where that matters.
#[derive(Debug)]
pub struct Frame<'a, C: Channel> {
    sample: Received<C>,
    reader: PhantomData<&'a mut Reader<C>>,
}

impl<C: Channel> Frame<'_, C> {
    const fn new(sample: Received<C>) -> Self {
        Self { sample, reader: PhantomData }
    }

    /// The frame's header.
    #[must_use]
    pub fn header(&self) -> &C::Header {
        self.sample.user_header()
    }

    /// The frame's slice.
    #[must_use]
    pub fn payload(&self) -> &[C::Row] {
        self.sample.payload()
    }
}

/// A frame in shared memory that is kept while this value lives, also after its reader. The process
/// is a member of the domain as long. Belongs to the reader's thread.
#[derive(Debug)]
pub struct KeptFrame<C: Channel> {
    // Dropped in this order.
    frame: Received<C>,
    _member: Rc<Membership>,
}

impl<C: Channel> KeptFrame<C> {
    /// The frame's header.
    #[must_use]
    pub fn header(&self) -> &C::Header {
        self.frame.user_header()
    }

    /// The frame's slice.
    #[must_use]
    pub fn payload(&self) -> &[C::Row] {
        self.frame.payload()
    }
}

/// Reason that no frame could be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
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
    Degraded {
        /// Connections failed since the port was opened.
        connections: u64,
    },
    /// iceoryx2 returned an error.
    #[error("cannot receive: {reason}")]
    Receive {
        /// The error of iceoryx2.
        reason: String,
    },
}
