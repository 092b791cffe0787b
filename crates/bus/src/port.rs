//! Ports: frames of samples, forecasts, diagnostics and budgets, one slice each.

use std::fmt::Debug;
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::port::{DegradationAction, LoanError};
use iceoryx2::prelude::{AllocationStrategy, EventId, ZeroCopySend, ipc};
use iceoryx2::sample::Sample as Borrowed;
use iceoryx2::sample_mut::SampleMut;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use joulebus_wire::{
    Budget, BudgetHeader, Diagnostic, DiagnosticHeader, Forecast, ForecastHeader, Sample,
    SampleHeader, Service, WakeEvent,
};

use crate::limits::Shape;
use crate::membership::Membership;
use crate::open::{OpenError, open, open_event};
use crate::room::{segment_bytes, shared_memory};
use crate::wait::{WaitError, Waiter, Waker};
use crate::{Bus, Limits, RoomError, clock, memory};

/// How long a reader waits before it makes its port anew, ns.
const HEAL_EVERY_NS: u64 = 1_000_000_000;

/// The worker's port for forecasts.
pub type ForecastWriter = Writer<ForecastHeader, Forecast>;
/// The worker's port for diagnostics.
pub type DiagnosticWriter = Writer<DiagnosticHeader, Diagnostic>;
/// The worker's port for budgets.
pub type BudgetWriter = Writer<BudgetHeader, Budget>;
/// A planner's port for forecasts.
pub type ForecastReader = Reader<ForecastHeader, Forecast>;
/// A planner's port for diagnostics.
pub type DiagnosticReader = Reader<DiagnosticHeader, Diagnostic>;
/// A planner's port for budgets.
pub type BudgetReader = Reader<BudgetHeader, Budget>;

/// Sends frames: a header `H` and a slice of `T`, written where readers read it.
pub struct Writer<H: Debug + ZeroCopySend + 'static, T: Debug + ZeroCopySend + 'static> {
    publisher: Publisher<ipc::Service, [T], H>,
    max_len: usize,
    degraded: Arc<AtomicU64>,
    // After the port: it must be gone before the process leaves.
    _member: Rc<Membership>,
}

impl<H, T> Writer<H, T>
where
    H: Debug + Copy + Default + ZeroCopySend + 'static,
    T: Debug + Copy + Default + ZeroCopySend + 'static,
{
    /// Sends a frame of `len` elements, element `i` being `element(i)`, written straight into
    /// shared memory. Returns how many readers got it. iceoryx2 allocates once.
    ///
    /// # Errors
    /// [`SendError`]; nothing was sent.
    pub fn send(
        &mut self,
        header: H,
        len: usize,
        element: impl FnMut(usize) -> T,
    ) -> Result<usize, SendError> {
        self.check(len)?;
        let mut loan = self
            .publisher
            .loan_slice_uninit(len)
            .map_err(SendError::loan)?;
        *loan.user_header_mut() = header;
        loan.write_from_fn(element).send().map_err(SendError::send)
    }

    /// Borrows memory for a frame of `len` elements, all default, to compute into; the frame goes
    /// with [`Loan::send`], or comes to nothing when dropped. iceoryx2 allocates once.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn loan(&mut self, len: usize) -> Result<Loan<'_, H, T>, SendError> {
        self.check(len)?;
        let mut sample = self.publisher.loan_slice(len).map_err(SendError::loan)?;
        *sample.user_header_mut() = H::default();
        Ok(Loan {
            sample,
            writer: PhantomData,
        })
    }

    /// Connects to readers that have come since the last frame: they get the history. Cheap when
    /// none have.
    pub fn update(&mut self) {
        // Failures are counted by the handler of degradations.
        let _ = self.publisher.update_connections();
    }

    /// Elements that one frame may hold.
    #[must_use]
    pub const fn max_len(&self) -> usize {
        self.max_len
    }

    /// Connections to readers that could not be made, or broke: they miss frames.
    #[must_use]
    pub fn degraded(&self) -> u64 {
        self.degraded.load(Ordering::Relaxed)
    }

    const fn check(&self, len: usize) -> Result<(), SendError> {
        if len > self.max_len {
            return Err(SendError::TooLong {
                found: len,
                allowed: self.max_len,
            });
        }
        Ok(())
    }
}

/// Memory of a frame to be sent: the slice by dereferencing.
pub struct Loan<'a, H: Debug + ZeroCopySend + 'static, T: Debug + ZeroCopySend + 'static> {
    sample: SampleMut<ipc::Service, [T], H>,
    writer: PhantomData<&'a mut Writer<H, T>>,
}

impl<H, T> Loan<'_, H, T>
where
    H: Debug + ZeroCopySend + 'static,
    T: Debug + ZeroCopySend + 'static,
{
    /// The frame's header.
    pub fn header_mut(&mut self) -> &mut H {
        self.sample.user_header_mut()
    }

    /// Sends the frame. Returns how many readers got it.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn send(self) -> Result<usize, SendError> {
        self.sample.send().map_err(SendError::send)
    }
}

impl<H, T> Deref for Loan<'_, H, T>
where
    H: Debug + ZeroCopySend + 'static,
    T: Debug + ZeroCopySend + 'static,
{
    type Target = [T];

    fn deref(&self) -> &[T] {
        self.sample.payload()
    }
}

impl<H, T> DerefMut for Loan<'_, H, T>
where
    H: Debug + ZeroCopySend + 'static,
    T: Debug + ZeroCopySend + 'static,
{
    fn deref_mut(&mut self) -> &mut [T] {
        self.sample.payload_mut()
    }
}

/// Reads frames in place.
pub struct Reader<H: Debug + ZeroCopySend + 'static, T: Debug + ZeroCopySend + 'static> {
    // Before the port, it before the factory, and all before the membership: the order in which
    // they must go.
    held: Option<Borrowed<ipc::Service, [T], H>>,
    subscriber: Option<Subscriber<ipc::Service, [T], H>>,
    factory: PortFactory<ipc::Service, [T], H>,
    buffer: usize,
    degraded: Arc<AtomicU64>,
    degraded_seen: u64,
    healed_ns: u64,
    _member: Rc<Membership>,
}

impl<H, T> Reader<H, T>
where
    H: Debug + ZeroCopySend + 'static,
    T: Debug + ZeroCopySend + 'static,
{
    /// The oldest frame that waits, in order; `None` when there is none. Frames that were
    /// overwritten before are known by the numbers in the headers.
    ///
    /// # Errors
    /// [`ReceiveError`]; the next call may succeed.
    pub fn take_next(&mut self) -> Result<Option<Frame<'_, H, T>>, ReceiveError> {
        Ok(self.receive()?.map(Frame::new))
    }

    /// The newest frame, older ones passed over; `None` when none has come since the last call.
    ///
    /// # Errors
    /// [`ReceiveError`]; the next call may succeed.
    pub fn take_latest(&mut self) -> Result<Option<Frame<'_, H, T>>, ReceiveError> {
        let mut latest = None;
        while let Some(newer) = self.receive()? {
            latest = Some(newer);
        }
        Ok(latest.map(Frame::new))
    }

    /// Takes all frames that wait and keeps the last that is `newer` than the one kept before;
    /// returns whether there was one. The frame is held in shared memory until a newer one is kept
    /// or the reader goes: [`Reader::held`]. Not to be mixed with the other ways to take.
    ///
    /// # Errors
    /// [`ReceiveError`] when nothing newer was found; the next call may succeed.
    pub fn hold_latest(&mut self, mut newer: impl FnMut(&H) -> bool) -> Result<bool, ReceiveError> {
        let mut found = false;
        loop {
            match self.receive() {
                Ok(Some(frame)) if newer(frame.user_header()) => {
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

    /// The frame that [`Reader::hold_latest`] keeps: its header and its slice. Its writer could
    /// still change it (it does not): who must be sure copies first.
    #[must_use]
    pub fn held(&self) -> Option<(&H, &[T])> {
        let held = self.held.as_ref()?;
        Some((held.user_header(), held.payload()))
    }

    /// Connections to writers that could not be made, or broke.
    #[must_use]
    pub fn degraded(&self) -> u64 {
        self.degraded.load(Ordering::Relaxed)
    }

    fn receive(&mut self) -> Result<Option<Borrowed<ipc::Service, [T], H>>, ReceiveError> {
        let Some(subscriber) = &self.subscriber else {
            self.heal()?;
            return Ok(None);
        };
        let received = subscriber
            .receive()
            .map_err(|reason| ReceiveError::Receive {
                reason: reason.to_string(),
            })?;
        if received.is_none() {
            self.check_connections()?;
        }
        Ok(received)
    }

    /// Gives the port up, to be made anew, when a connection has failed since the last look.
    fn check_connections(&mut self) -> Result<(), ReceiveError> {
        if self.degraded() == self.degraded_seen {
            return Ok(());
        }
        self.degraded_seen = self.degraded();
        self.subscriber = None;
        self.healed_ns = clock::monotonic_ns();
        Err(ReceiveError::Degraded {
            connections: self.degraded_seen,
        })
    }

    /// iceoryx2 does not try a failed connection again: only a new port does.
    fn heal(&mut self) -> Result<(), ReceiveError> {
        let now_ns = clock::monotonic_ns();
        if now_ns.saturating_sub(self.healed_ns) < HEAL_EVERY_NS {
            return Ok(());
        }
        self.healed_ns = now_ns;
        self.subscriber = Some(subscribe(&self.factory, self.buffer, &self.degraded)?);
        Ok(())
    }
}

fn subscribe<H, T>(
    factory: &PortFactory<ipc::Service, [T], H>,
    buffer: usize,
    degraded: &Arc<AtomicU64>,
) -> Result<Subscriber<ipc::Service, [T], H>, ReceiveError>
where
    H: Debug + ZeroCopySend + 'static,
    T: Debug + ZeroCopySend + 'static,
{
    let counted = Arc::clone(degraded);
    factory
        .subscriber_builder()
        .buffer_size(buffer)
        .set_degradation_handler(move |_, _| count_degradation(&counted))
        .create()
        .map_err(|reason| ReceiveError::Receive {
            reason: reason.to_string(),
        })
}

/// Counts instead of failing at once: failing would leave the ports after this one unconnected
/// too, and nothing would try them again. The reader turns the count into an error.
fn count_degradation(counted: &AtomicU64) -> DegradationAction {
    counted.fetch_add(1, Ordering::Relaxed);
    DegradationAction::Ignore
}

/// A frame in shared memory, held for as long as this lives: the slice by dereferencing.
///
/// Its writer could still change it (it does not): who must be sure copies first.
pub struct Frame<'a, H: Debug + ZeroCopySend + 'static, T: Debug + ZeroCopySend + 'static> {
    sample: Borrowed<ipc::Service, [T], H>,
    reader: PhantomData<&'a mut Reader<H, T>>,
}

impl<H, T> Frame<'_, H, T>
where
    H: Debug + ZeroCopySend + 'static,
    T: Debug + ZeroCopySend + 'static,
{
    const fn new(sample: Borrowed<ipc::Service, [T], H>) -> Self {
        Self {
            sample,
            reader: PhantomData,
        }
    }

    /// The frame's header.
    #[must_use]
    pub fn header(&self) -> &H {
        self.sample.user_header()
    }
}

impl<H, T> Deref for Frame<'_, H, T>
where
    H: Debug + ZeroCopySend + 'static,
    T: Debug + ZeroCopySend + 'static,
{
    type Target = [T];

    fn deref(&self) -> &[T] {
        self.sample.payload()
    }
}

/// A source's port: sends frames of samples and wakes the worker.
pub struct SampleWriter {
    writer: Writer<SampleHeader, Sample>,
    waker: Waker,
}

impl SampleWriter {
    /// Sends a frame of `len` samples, sample `i` being `sample(i)`, written straight into shared
    /// memory, and wakes the worker. Returns how many readers got it: 0 means that no worker runs.
    ///
    /// # Errors
    /// [`SendError`]; [`SendError::Wake`] if the frame was sent but the worker not woken.
    pub fn send(
        &mut self,
        header: SampleHeader,
        len: usize,
        sample: impl FnMut(usize) -> Sample,
    ) -> Result<usize, SendError> {
        let readers = self.writer.send(header, len, sample)?;
        self.waker.wake(WakeEvent::Frame).map_err(SendError::Wake)?;
        Ok(readers)
    }

    /// Samples that one frame may hold.
    #[must_use]
    pub const fn max_len(&self) -> usize {
        self.writer.max_len()
    }

    /// Connections to readers that could not be made, or broke.
    #[must_use]
    pub fn degraded(&self) -> u64 {
        self.writer.degraded()
    }
}

/// The worker's port for samples of all sources.
pub struct SampleReader {
    reader: Reader<SampleHeader, Sample>,
}

impl SampleReader {
    pub(crate) const fn new(reader: Reader<SampleHeader, Sample>) -> Self {
        Self { reader }
    }

    /// Copies the next frame into `frame`; whether there was one. Take until there is none: the
    /// sources come one after the other. Each byte is read from shared memory once, so what is
    /// checked afterwards cannot change any more.
    ///
    /// # Errors
    /// [`ReceiveError`]; the next call may succeed.
    pub fn take(&mut self, frame: &mut FrameBuf) -> Result<bool, ReceiveError> {
        let Some(received) = self.reader.receive()? else {
            return Ok(false);
        };
        let samples = received.payload();
        let kept = samples.len().min(frame.capacity);
        frame.header = *received.user_header();
        frame.truncated = samples.len() - kept;
        frame.samples.clear();
        frame.samples.extend_from_slice(&samples[..kept]);
        Ok(true)
    }

    /// Connections to sources that could not be made, or broke.
    #[must_use]
    pub fn degraded(&self) -> u64 {
        self.reader.degraded()
    }
}

/// A process's own copy of a frame of samples. Allocates when made, then never.
#[derive(Debug, Clone)]
pub struct FrameBuf {
    header: SampleHeader,
    samples: Vec<Sample>,
    truncated: usize,
    capacity: usize,
}

impl FrameBuf {
    /// Room for frames of up to `capacity` samples.
    #[must_use]
    pub fn new(capacity: usize) -> Self {
        Self {
            header: SampleHeader::default(),
            samples: Vec::with_capacity(capacity),
            truncated: 0,
            capacity,
        }
    }

    /// The header.
    #[must_use]
    pub const fn header(&self) -> &SampleHeader {
        &self.header
    }

    /// The samples, at most the capacity.
    #[must_use]
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// Samples of the frame past the capacity, which were not copied.
    #[must_use]
    pub const fn truncated(&self) -> usize {
        self.truncated
    }
}

pub(crate) fn sample_writer(
    bus: &Bus,
    limits: &Limits,
    max_len: usize,
) -> Result<SampleWriter, OpenError> {
    if max_len < 1 || max_len > limits.capacity {
        return Err(OpenError::Length {
            found: max_len,
            allowed: limits.capacity,
        });
    }
    Ok(SampleWriter {
        writer: writer(bus, Service::Samples, limits, limits.samples(), max_len)?,
        waker: waker(bus, Service::Arrivals, limits, limits.arrivals())?,
    })
}

pub(crate) fn writer<H, T>(
    bus: &Bus,
    service: Service,
    limits: &Limits,
    shape: Shape,
    max_len: usize,
) -> Result<Writer<H, T>, OpenError>
where
    H: Debug + ZeroCopySend + 'static,
    T: Debug + ZeroCopySend + 'static,
{
    let needed = segment_bytes(shape, size_of::<H>(), size_of::<T>(), max_len);
    let (free, _) = shared_memory()?;
    if needed > free {
        return Err(RoomError::Memory { needed, free }.into());
    }
    let degraded = Arc::new(AtomicU64::new(0));
    let counted = Arc::clone(&degraded);
    let publisher = open::<H, T>(bus, service, limits, shape)?
        .publisher_builder()
        .initial_max_slice_len(max_len)
        .max_loaned_samples(1)
        .allocation_strategy(AllocationStrategy::Static)
        .set_degradation_handler(move |_, _| count_degradation(&counted))
        .create()
        .map_err(|reason| OpenError::port(service, reason))?;
    memory::take(&publisher.id().value().to_string())
        .map_err(|source| OpenError::Memory { needed, source })?;
    Ok(Writer {
        publisher,
        max_len,
        degraded,
        _member: Rc::clone(&bus.member),
    })
}

pub(crate) fn reader<H, T>(
    bus: &Bus,
    service: Service,
    limits: &Limits,
    shape: Shape,
) -> Result<Reader<H, T>, OpenError>
where
    H: Debug + ZeroCopySend + 'static,
    T: Debug + ZeroCopySend + 'static,
{
    let factory = open::<H, T>(bus, service, limits, shape)?;
    let degraded = Arc::new(AtomicU64::new(0));
    let subscriber = subscribe(&factory, shape.buffer, &degraded)
        .map_err(|reason| OpenError::port(service, reason))?;
    Ok(Reader {
        held: None,
        subscriber: Some(subscriber),
        factory,
        buffer: shape.buffer,
        degraded,
        degraded_seen: 0,
        healed_ns: 0,
        _member: Rc::clone(&bus.member),
    })
}

pub(crate) fn waker(
    bus: &Bus,
    service: Service,
    limits: &Limits,
    ports: (usize, usize),
) -> Result<Waker, OpenError> {
    let notifier = open_event(bus, service, limits, ports)?
        .notifier_builder()
        .default_event_id(EventId::new(WakeEvent::Frame.id()))
        .create()
        .map_err(|reason| OpenError::port(service, reason))?;
    Ok(Waker::new(notifier, Rc::clone(&bus.member)))
}

pub(crate) fn waiter(
    bus: &Bus,
    service: Service,
    limits: &Limits,
    ports: (usize, usize),
) -> Result<Waiter, OpenError> {
    let listener = open_event(bus, service, limits, ports)?
        .listener_builder()
        .create()
        .map_err(|reason| OpenError::port(service, reason))?;
    Ok(Waiter::new(listener, Rc::clone(&bus.member)))
}

/// Why a frame was not sent.
#[derive(Debug, thiserror::Error)]
pub enum SendError {
    /// The frame is longer than the port was opened for.
    #[error("a frame of {found} elements, allowed are {allowed}")]
    TooLong {
        /// Elements in the frame.
        found: usize,
        /// Elements allowed.
        allowed: usize,
    },
    /// No memory for the frame: readers hold more than they may.
    #[error("no memory for a frame: {reason}")]
    Loan {
        /// What iceoryx2 said.
        reason: String,
    },
    /// The frame could not be delivered to anybody.
    #[error("cannot send a frame: {reason}; join again")]
    Send {
        /// What iceoryx2 said.
        reason: String,
    },
    /// The frame was sent, but the worker was not woken.
    #[error("the frame was sent, but {0}")]
    Wake(WaitError),
}

impl SendError {
    fn loan(reason: LoanError) -> Self {
        Self::Loan {
            reason: reason.to_string(),
        }
    }

    fn send(reason: iceoryx2::port::SendError) -> Self {
        Self::Send {
            reason: reason.to_string(),
        }
    }
}

/// Why no frame could be read.
#[derive(Debug, thiserror::Error)]
pub enum ReceiveError {
    /// A writer could not be connected to; its frames are missing. The port is made anew within a
    /// second or two.
    #[error(
        "{connections} connections to writers failed so far; are there file descriptors left \
         (`ulimit -n`), and shared memory? `joulebus doctor` tells"
    )]
    Degraded {
        /// Connections failed since the port was opened.
        connections: u64,
    },
    /// iceoryx2 refused.
    #[error("cannot receive: {reason}")]
    Receive {
        /// What iceoryx2 said.
        reason: String,
    },
}
