//! The port of a writer, compiled once for all channels.
#![allow(unsafe_code)] // Memory of a frame is lent without being written to first.

use std::ptr;
use std::rc::Rc;
use std::sync::Arc;

use iceoryx2::port::publisher::{Publisher, PublisherCreateError};
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::port::{DegradationAction, LoanError};
use iceoryx2::prelude::{AllocationStrategy, CallbackProgression};
use iceoryx2::sample_mut::SampleMut;
use iceoryx2::service::marker::{CustomHeaderMarker, CustomPayloadMarker};
use iceoryx2::service::port_factory::PortFactory as _;

use super::degradation::Failures;
use super::repair::Repair;
use super::service::{self, Factory, FrameTypes, OpenError};
use super::wait::WaitError;
use crate::ipc::Ipc;
use crate::liveness::guarded::{DropsHere, Guarded};
use crate::membership::Membership;
use crate::os::memory;
use crate::preflight::{check_memory, segment_bytes};
use crate::{Bus, FilesRemoved, Limits, clock};

type Port = Publisher<Ipc, [CustomPayloadMarker], CustomHeaderMarker>;

/// Memory of a frame to send.
#[derive(Debug)]
pub(super) struct OutFrame(DropsHere<SampleMut<Ipc, [CustomPayloadMarker], CustomHeaderMarker>>);

impl OutFrame {
    /// Address of its header. A reference to a value of size 0 leads to no memory behind it, so the
    /// pointer is made anew: iceoryx2 exposes that to its memory.
    pub(super) fn header_mut(&mut self) -> *mut CustomHeaderMarker {
        ptr::with_exposed_provenance_mut(ptr::from_mut(self.0.user_header_mut()).addr())
    }

    pub(super) fn bytes_mut(&mut self) -> *mut [CustomPayloadMarker] {
        self.0.payload_mut()
    }

    /// Sends it. Returns the number of readers reached.
    pub(super) fn send(self) -> Result<usize, SendError> {
        self.0.into_inner().send().map_err(SendError::send)
    }
}

/// Sends frames of one channel.
#[derive(Debug)]
pub(super) struct Outlet {
    // Dropped in this order: port, factory, membership.
    port: Guarded<(Port, Factory)>,
    max_len: usize,
    failures: Arc<Failures>,
    repair: Repair,
    member: Rc<Membership>,
}

impl Outlet {
    pub(super) fn open(
        bus: &Bus,
        limits: &Limits,
        types: &FrameTypes,
        max_len: usize,
    ) -> Result<Self, OpenError> {
        let service = types.service;
        let needed = segment_bytes(limits, types.flow, types.sizes(), max_len);
        check_memory(usize::try_from(needed).unwrap_or(usize::MAX))?;
        let failures = Failures::new();
        let factory = service::open(bus, limits, types)?;
        let create = || {
            factory
                .publisher_builder()
                .initial_max_slice_len(max_len)
                .max_loaned_samples(1)
                .allocation_strategy(AllocationStrategy::Static)
                .set_degradation_handler(failures.handler(|info| info.receiver_port_id))
                .create()
        };
        let is_full =
            |error: &_| matches!(error, PublisherCreateError::ExceedsMaxSupportedPublishers);
        let publisher = service::create(bus, create, is_full)
            .map_err(|reason| OpenError::port(service, reason))?;
        service::check_shortage()?;
        memory::populate(&publisher.id().value().to_string());
        let need = service::need(&bus.member, &factory, Some(publisher.id().value()));
        Ok(Self {
            port: Guarded::new((publisher, factory), need),
            max_len,
            failures,
            repair: Repair::default(),
            member: Rc::clone(&bus.member),
        })
    }

    /// Borrows memory for a frame of `len` rows. It contains an earlier frame, or zeros. iceoryx2
    /// allocates once.
    pub(super) fn lend(&mut self, len: usize) -> Result<OutFrame, SendError> {
        self.member.presence.check()?;
        self.reconnect();
        if len > self.max_len {
            return Err(SendError::TooLong { found: len, allowed: self.max_len });
        }
        // SAFETY: the service has rows of a dynamic number, of the size that `open` stated.
        let lent = unsafe { self.port.0.loan_custom_payload(len) }.map_err(SendError::loan)?;
        // SAFETY: the memory is a mapping of a shared memory object: the kernel provides zeroed
        // pages, and all other bytes in it are those of an earlier frame. So all of it is
        // initialised, and every bit pattern is a valid byte.
        Ok(OutFrame(DropsHere::new(unsafe { lent.assume_init() })))
    }

    /// Connects to readers that have joined since the last frame: they receive the history. Cheap
    /// if there are none.
    pub(super) fn update(&mut self) {
        self.reconnect();
        // The degradation handler counts failures.
        let _ = self.port.0.update_connections();
    }

    /// Number of readers of the service. A killed one counts until the cleanup.
    pub(super) fn readers(&self) -> usize {
        self.port.1.dynamic_config().number_of_subscribers()
    }

    /// Maximum number of elements per frame.
    pub(super) const fn max_len(&self) -> usize {
        self.max_len
    }

    /// Number of failed or broken connections to readers: these miss frames.
    pub(super) fn degraded(&self) -> u64 {
        self.failures.count()
    }

    /// Retries failed connections to readers. iceoryx2 does so when the list of readers has
    /// changed, and a reader that joins for a moment changes it. A new port of this writer would do
    /// as well, but the other readers would lose frames.
    fn reconnect(&mut self) {
        let (publisher, factory) = &*self.port;
        let is_listed = || {
            self.failures.are_listed(|each| {
                factory.dynamic_config().list_subscribers(|reader| {
                    each(reader.subscriber_id.value());
                    CallbackProgression::Continue
                });
            })
        };
        let failed = self.failures.count();
        if !self.repair.is_due(failed, clock::monotonic_ns, is_listed) {
            return;
        }
        let joined = factory
            .subscriber_builder()
            .set_degradation_handler(|_, _| DegradationAction::Ignore)
            .create();
        let updated = publisher.update_connections();
        let failed_now = self.failures.count();
        let is_whole = joined.is_ok() && updated.is_ok() && failed_now == failed;
        self.repair.retried(failed_now, is_whole);
        if is_whole {
            self.failures.forget();
        }
    }
}

/// A frame that was sent, by a port that also wakes who reads it.
#[derive(Debug)]
pub struct Sent {
    /// Number of readers reached.
    pub readers: usize,
    /// Error that woke nobody, if any: readers find the frame at their next check, within 100 ms.
    pub not_woken: Option<WaitError>,
}

/// Reason that a frame was not sent.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum SendError {
    /// Files of this process were removed.
    #[error(transparent)]
    Removed(#[from] FilesRemoved),
    /// The frame is longer than the port was opened for.
    #[error("a frame of {found} elements, allowed are {allowed}")]
    TooLong { found: usize, allowed: usize },
    /// No memory for the frame: readers hold more frames than allowed.
    #[error("no memory for a frame: {reason}")]
    Loan { reason: String },
    /// The frame could not be delivered to any reader.
    #[error("cannot send a frame: {reason}. The next may pass. If none does, join again")]
    Send { reason: String },
}

impl SendError {
    /// True if every further frame will fail as well: this process must end, or join again.
    pub const fn is_final(&self) -> bool {
        matches!(self, Self::Removed(_))
    }

    pub(super) fn loan(reason: LoanError) -> Self {
        Self::Loan { reason: reason.to_string() }
    }

    pub(super) fn send(reason: iceoryx2::port::SendError) -> Self {
        Self::Send { reason: reason.to_string() }
    }
}
