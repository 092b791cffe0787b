//! Sends frames: a header and a slice, written in place in shared memory.
#![allow(unsafe_code)] // Memory of a frame is lent without being written to first.

use std::marker::PhantomData;
use std::rc::Rc;
use std::sync::Arc;

use iceoryx2::port::publisher::{Publisher, PublisherCreateError};
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::port::{DegradationAction, LoanError};
use iceoryx2::prelude::{AllocationStrategy, CallbackProgression};
use iceoryx2::sample_mut::SampleMut;
use iceoryx2::service::port_factory::PortFactory as _;
use joulebus_wire::Channel;

use super::degradation::Failures;
use super::repair::Repair;
use super::service::{self, Factory, OpenError};
use super::wait::WaitError;
use crate::ipc::Ipc;
use crate::liveness::kept::Kept;
use crate::membership::Membership;
use crate::os::memory;
use crate::preflight::{check_memory, segment_bytes};
use crate::{Bus, FilesRemoved, Limits, clock};

type Port<C> = (Publisher<Ipc, [<C as Channel>::Row], <C as Channel>::Header>, Factory<C>);

/// Sends frames of a channel, written in place in shared memory.
#[derive(Debug)]
pub struct Writer<C: Channel> {
    // Dropped in this order: port, factory, membership.
    port: Kept<Port<C>>,
    max_len: usize,
    failures: Arc<Failures>,
    repair: Repair,
    member: Rc<Membership>,
}

impl<C: Channel> Writer<C> {
    pub(super) fn open(bus: &Bus, limits: &Limits, max_len: usize) -> Result<Self, OpenError> {
        let service = C::SERVICE;
        let needed = segment_bytes::<C>(limits, max_len);
        check_memory(usize::try_from(needed).unwrap_or(usize::MAX))?;
        let failures = Failures::new();
        let factory = service::open::<C>(bus, limits)?;
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
        let need = service::need(bus, &factory, Some(publisher.id().value()));
        Ok(Self {
            port: Kept::new((publisher, factory), need),
            max_len,
            failures,
            repair: Repair::default(),
            member: Rc::clone(&bus.member),
        })
    }

    /// Sends a frame of `len` elements, element `i` being `element(i)`, written directly to shared
    /// memory. Returns the number of readers reached. iceoryx2 allocates once.
    ///
    /// # Errors
    /// [`SendError`]. Nothing was sent.
    pub fn send(
        &mut self,
        header: C::Header,
        len: usize,
        element: impl FnMut(usize) -> C::Row,
    ) -> Result<usize, SendError> {
        self.check(len)?;
        let mut loan = self.port.0.loan_slice_uninit(len).map_err(SendError::loan)?;
        *loan.user_header_mut() = header;
        loan.write_from_fn(element).send().map_err(SendError::send)
    }

    /// Borrows memory for a frame of `len` elements, all default, to compute into. [`Loan::send`]
    /// sends the frame, dropping it discards it. iceoryx2 allocates once.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn loan(&mut self, len: usize) -> Result<Loan<'_, C>, SendError> {
        self.check(len)?;
        let mut sample = self.port.0.loan_slice(len).map_err(SendError::loan)?;
        *sample.user_header_mut() = C::Header::default();
        Ok(Loan { sample, writer: PhantomData })
    }

    /// As [`Writer::loan`], for a caller that writes every element: until then they contain those
    /// of an earlier frame, or zeros. Saves a pass over memory that fits into no cache.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn loan_to_fill(&mut self, len: usize) -> Result<Loan<'_, C>, SendError> {
        self.check(len)?;
        let mut sample = self.port.0.loan_slice_uninit(len).map_err(SendError::loan)?;
        *sample.user_header_mut() = C::Header::default();
        // SAFETY: the memory is a mapping of a shared memory object: the kernel provides zeroed
        // pages, and all other bytes in it are those of an earlier frame. So all of it is
        // initialised, and every bit pattern is a valid payload.
        let sample = unsafe { sample.assume_init() };
        Ok(Loan { sample, writer: PhantomData })
    }

    /// Connects to readers that have joined since the last frame: they receive the history. Cheap
    /// if there are none.
    pub fn update(&mut self) {
        self.reconnect();
        // The degradation handler counts failures.
        let _ = self.port.0.update_connections();
    }

    /// Number of readers of the service. A killed one counts until the cleanup.
    #[must_use]
    pub fn readers(&self) -> usize {
        self.port.1.dynamic_config().number_of_subscribers()
    }

    /// Maximum number of elements per frame.
    #[must_use]
    pub const fn max_len(&self) -> usize {
        self.max_len
    }

    /// Number of failed or broken connections to readers: these miss frames.
    #[must_use]
    pub fn degraded(&self) -> u64 {
        self.failures.count()
    }

    fn check(&mut self, len: usize) -> Result<(), SendError> {
        self.member.presence.check()?;
        self.reconnect();
        if len > self.max_len {
            return Err(SendError::TooLong { found: len, allowed: self.max_len });
        }
        Ok(())
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

/// Memory of a frame to send.
#[derive(Debug)]
pub struct Loan<'a, C: Channel> {
    sample: SampleMut<Ipc, [C::Row], C::Header>,
    writer: PhantomData<&'a mut Writer<C>>,
}

impl<C: Channel> Loan<'_, C> {
    /// The frame's header.
    pub fn header_mut(&mut self) -> &mut C::Header {
        self.sample.user_header_mut()
    }

    /// The frame's slice.
    pub fn payload_mut(&mut self) -> &mut [C::Row] {
        self.sample.payload_mut()
    }

    /// Sends the frame. Returns the number of readers reached.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn send(self) -> Result<usize, SendError> {
        self.sample.send().map_err(SendError::send)
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
pub enum SendError {
    /// Files of this process were removed.
    #[error(transparent)]
    Removed(#[from] FilesRemoved),
    /// The frame is longer than the port was opened for.
    #[error("a frame of {found} elements, allowed are {allowed}")]
    TooLong {
        /// Elements in the frame.
        found: usize,
        /// Elements allowed.
        allowed: usize,
    },
    /// No memory for the frame: readers hold more frames than allowed.
    #[error("no memory for a frame: {reason}")]
    Loan {
        /// The error of iceoryx2.
        reason: String,
    },
    /// The frame could not be delivered to any reader.
    #[error("cannot send a frame: {reason}. Join again")]
    Send {
        /// The error of iceoryx2.
        reason: String,
    },
}

impl SendError {
    /// True if every further frame will fail as well: this process must end, or join again.
    #[must_use]
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
