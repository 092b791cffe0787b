//! Ports: queues of frames.

use std::any::Any;
use std::cell::RefCell;
use std::marker::PhantomData;
use std::rc::Rc;

use joulebus_simulated_host::{self as host, memory::outside};
use joulebus_wire::{
    Budget, BudgetHeader, Diagnostic, DiagnosticHeader, Forecast, ForecastHeader, Payload,
    PlanState, PlanStateHeader, QueriesHeader, Sample, SampleHeader, Service, StateHeader,
    TakenFrame, TickHeader, WakeEvent,
};

use crate::liveness::worker_ports::WorkerPorts;
use crate::query::{QueryClient, QueryServer};
use crate::queues::{Connection, Listed, Queue, Sent, port_id, with};
use crate::{Bus, Limits, OpenError, Poller, ReceiveError, SendError, Waiter, Waker};
use joulebus_domain::Shape;

/// As of the real reader.
const MOST_PASSED_OVER: u32 = 4_096;

/// The worker's port for forecasts.
pub type ForecastWriter = Writer<ForecastHeader, Forecast>;
/// The worker's port for diagnostics.
pub type DiagnosticWriter = Writer<DiagnosticHeader, Diagnostic>;
/// The worker's port for budgets.
pub type BudgetWriter = Writer<BudgetHeader, Budget>;
/// The worker's port for what plans start from.
pub type PlanStateWriter = Writer<PlanStateHeader, PlanState>;
/// A planner's port for what plans start from.
pub type PlanStateReader = Reader<PlanStateHeader, PlanState>;
/// The worker's port for its journal.
pub type TickWriter = Writer<TickHeader, TakenFrame>;
/// The worker's port for keyframes.
pub type StateWriter = Writer<StateHeader, u8>;
/// A planner's port for forecasts.
pub type ForecastReader = Reader<ForecastHeader, Forecast>;
/// A planner's port for diagnostics.
pub type DiagnosticReader = Reader<DiagnosticHeader, Diagnostic>;
/// A planner's port for budgets.
pub type BudgetReader = Reader<BudgetHeader, Budget>;
/// A recorder's port for keyframes.
pub type StateReader = Reader<StateHeader, u8>;
/// The worker's port for records of questions.
pub type QueriesWriter = Writer<QueriesHeader, u64>;
/// A recorder's port for records of questions.
pub type QueriesReader = Reader<QueriesHeader, u64>;
/// A recorder's port for samples.
pub type SampleTap = Reader<SampleHeader, Sample>;
/// A recorder's port for the worker's journal.
pub type TickReader = Reader<TickHeader, TakenFrame>;

fn refused(service: Service, reason: &str) -> OpenError {
    OpenError::Port {
        service: service.name(),
        reason: reason.to_owned(),
    }
}

/// Sends frames.
#[derive(Debug)]
pub struct Writer<H: Payload, T: Payload> {
    port: u128,
    service: Service,
    max_len: usize,
    /// The last frame, for readers that join later.
    history: Option<Rc<Sent<H, T>>>,
    keeps_history: bool,
    bus: Bus,
}

impl<H: Payload, T: Payload> Writer<H, T> {
    fn open(bus: &Bus, service: Service, shape: Shape, max_len: usize) -> Result<Self, OpenError> {
        host::operation();
        crate::left::check_left()?;
        bus.check()?;
        let port = port_id(bus.pid);
        with(service, |state| {
            if state.writers.len() == shape.publishers {
                return Err(refused(service, "ExceedsMaxSupportedPublishers"));
            }
            state.writers.push((port, bus.pid));
            Ok(())
        })?;
        Ok(Self {
            port,
            service,
            max_len,
            history: None,
            keeps_history: shape.history > 0,
            bus: bus.clone(),
        })
    }

    /// Sends a frame of `len` elements; returns the number of readers reached.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn send(
        &mut self,
        header: H,
        len: usize,
        element: impl FnMut(usize) -> T,
    ) -> Result<usize, SendError> {
        self.check(len)?;
        let payload = outside(|| (0..len).map(element).collect());
        Ok(self.deliver(header, payload))
    }

    /// Memory for a frame of `len` elements.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn loan_to_fill(&mut self, len: usize) -> Result<Loan<'_, H, T>, SendError> {
        self.check(len)?;
        Ok(Loan {
            header: H::default(),
            payload: outside(|| vec![T::default(); len]),
            writer: self,
        })
    }

    /// Gives readers that have joined the last frame.
    pub fn update(&mut self) {
        host::operation();
        let Some(frame) = self.history.clone().filter(|_| !host::is_dead()) else {
            return;
        };
        for (pid, queue) in self.queues() {
            if let Ok(queue) = queue.downcast::<RefCell<Queue<H, T>>>() {
                let mut queue = queue.borrow_mut();
                let mut connections = queue.connections.iter();
                let is_new = !connections.any(|connection| connection.port == self.port);
                if is_new && host::has_descriptors(pid) && !host::memory_is_full() {
                    outside(|| {
                        queue.connections.push(Connection {
                            port: self.port,
                            frames: [Rc::clone(&frame)].into(),
                        });
                    });
                }
            }
        }
    }

    /// Number of readers.
    #[must_use]
    pub fn readers(&self) -> usize {
        with(self.service, |state| state.readers.len())
    }

    /// Maximum number of elements per frame.
    #[must_use]
    pub const fn max_len(&self) -> usize {
        self.max_len
    }

    /// Connections of a writer do not fail.
    #[must_use]
    pub const fn degraded(&self) -> u64 {
        0
    }

    fn check(&self, len: usize) -> Result<(), SendError> {
        host::operation();
        self.bus.check()?;
        if len > self.max_len {
            return Err(SendError::TooLong {
                found: len,
                allowed: self.max_len,
            });
        }
        Ok(())
    }

    fn deliver(&mut self, header: H, payload: Vec<T>) -> usize {
        host::operation();
        if host::is_dead() {
            return 0;
        }
        let frame = outside(|| {
            Rc::new(Sent {
                header,
                payload,
                port: self.port,
            })
        });
        let mut reached = 0;
        for (pid, queue) in self.queues() {
            // A process of another version would be refused by iceoryx2.
            if let Ok(queue) = queue.downcast::<RefCell<Queue<H, T>>>() {
                let is_reached = outside(|| self.push(&frame, pid, &mut queue.borrow_mut()));
                reached += usize::from(is_reached);
            }
        }
        self.history = self.keeps_history.then_some(frame);
        reached
    }

    /// The readers' queues, each with the reader's process.
    fn queues(&self) -> Vec<(u32, Rc<dyn Any>)> {
        with(self.service, |state| {
            let readers = state.readers.iter();
            readers
                .map(|reader| (reader.pid, Rc::clone(&reader.queue)))
                .collect()
        })
    }

    /// Puts a frame into the queue of a reader of process `pid`; the oldest is overwritten.
    fn push(&self, frame: &Rc<Sent<H, T>>, pid: u32, queue: &mut Queue<H, T>) -> bool {
        let mut connections = queue.connections.iter_mut();
        let buffer = queue.buffer;
        if let Some(connection) = connections.find(|connection| connection.port == self.port) {
            if connection.frames.len() == buffer {
                connection.frames.pop_front();
            }
            connection.frames.push_back(Rc::clone(frame));
            return true;
        }
        if !host::has_descriptors(pid) || host::memory_is_full() {
            queue.failed += 1;
            return false;
        }
        let history = self.history.iter().cloned();
        queue.connections.push(Connection {
            port: self.port,
            frames: history.chain([Rc::clone(frame)]).collect(),
        });
        true
    }
}

impl<H: Payload, T: Payload> Drop for Writer<H, T> {
    fn drop(&mut self) {
        with(self.service, |state| {
            state.writers.retain(|(port, _)| *port != self.port);
        });
    }
}

/// Memory of a frame to send.
#[derive(Debug)]
pub struct Loan<'a, H: Payload, T: Payload> {
    header: H,
    payload: Vec<T>,
    writer: &'a mut Writer<H, T>,
}

impl<H: Payload, T: Payload> Loan<'_, H, T> {
    /// The frame's header.
    pub const fn header_mut(&mut self) -> &mut H {
        &mut self.header
    }

    /// The frame's slice.
    pub fn payload_mut(&mut self) -> &mut [T] {
        &mut self.payload
    }

    /// Sends the frame.
    ///
    /// # Errors
    /// None.
    pub fn send(self) -> Result<usize, SendError> {
        Ok(self.writer.deliver(self.header, self.payload))
    }
}

/// Reads frames.
#[derive(Debug)]
pub struct Reader<H: Payload, T: Payload> {
    number: u64,
    held: Option<Rc<Sent<H, T>>>,
    queue: Rc<RefCell<Queue<H, T>>>,
    /// Frames that can be queued at once, of all writers.
    queued: usize,
    service: Service,
    worker: Option<WorkerPorts>,
    bus: Bus,
}

impl<H: Payload, T: Payload> Reader<H, T> {
    fn open(bus: &Bus, service: Service, shape: Shape) -> Result<Self, OpenError> {
        host::operation();
        crate::left::check_left()?;
        bus.check()?;
        let queue = outside(|| {
            Rc::new(RefCell::new(Queue {
                connections: Vec::new(),
                buffer: shape.buffer,
                failed: 0,
            }))
        });
        let number = host::number();
        with(service, |state| {
            if state.readers.len() == shape.subscribers {
                return Err(refused(service, "ExceedsMaxSupportedSubscribers"));
            }
            state.readers.push(Listed {
                number,
                pid: bus.pid,
                queue: Rc::clone(&queue) as _,
            });
            Ok(())
        })?;
        Ok(Self {
            number,
            held: None,
            queue,
            queued: shape.buffer * shape.publishers,
            service,
            worker: (service != Service::Samples).then(|| WorkerPorts::new(&bus.domain)),
            bus: bus.clone(),
        })
    }

    /// Calls `each` for all queued frames.
    ///
    /// # Errors
    /// [`ReceiveError`].
    pub fn take_all(&mut self, mut each: impl FnMut(&H, &[T])) -> Result<(), ReceiveError> {
        for _ in 0..self.queued {
            let Some(frame) = self.receive()? else {
                break;
            };
            each(&frame.header, &frame.payload);
        }
        Ok(())
    }

    /// The newest frame.
    ///
    /// # Errors
    /// [`ReceiveError`].
    pub fn take_latest(&mut self) -> Result<Option<Frame<'_, H, T>>, ReceiveError> {
        let mut latest = None;
        while let Some(newer) = self.receive()? {
            latest = Some(newer);
        }
        Ok(latest.map(|sent| Frame {
            sent,
            reader: PhantomData,
        }))
    }

    /// Holds the last frame that is `newer` than the held one.
    ///
    /// # Errors
    /// [`ReceiveError`].
    pub fn hold_latest(
        &mut self,
        mut newer: impl FnMut(&H, &[T], u64) -> bool,
    ) -> Result<bool, ReceiveError> {
        let mut found = false;
        while let Some(frame) = self.receive()? {
            let runs = self.worker.as_ref().map_or(0, WorkerPorts::runs);
            if newer(&frame.header, &frame.payload, runs) {
                self.held = Some(frame);
                found = true;
            }
        }
        Ok(found)
    }

    /// The frame held.
    #[must_use]
    pub fn held(&self) -> Option<(&H, &[T])> {
        let held = self.held.as_ref()?;
        Some((&held.header, &held.payload))
    }

    /// Moves the frame of [`Reader::held`] out of the reader.
    #[must_use]
    pub fn take_held(&mut self) -> Option<KeptFrame<H, T>> {
        let frame = self.held.take()?;
        Some(KeptFrame { frame })
    }

    /// Number of failed connections.
    #[must_use]
    pub fn degraded(&self) -> u64 {
        self.queue.borrow().failed
    }

    /// Number of frames of others than the worker.
    #[must_use]
    pub fn foreign(&self) -> u64 {
        self.worker.as_ref().map_or(0, WorkerPorts::foreign)
    }

    fn receive(&mut self) -> Result<Option<Rc<Sent<H, T>>>, ReceiveError> {
        host::operation();
        self.bus.check()?;
        let mut passed_over = 0;
        loop {
            let Some(frame) = self.pop() else {
                return Ok(None);
            };
            let worker = self.worker.as_mut();
            if worker.is_none_or(|worker| worker.admits(frame.port)) {
                return Ok(Some(frame));
            }
            passed_over += 1;
            if passed_over == MOST_PASSED_OVER {
                return Ok(None);
            }
        }
    }

    /// The oldest frame of one of the writers, any of them.
    fn pop(&mut self) -> Option<Rc<Sent<H, T>>> {
        let queue = &mut *self.queue.borrow_mut();
        let count = queue.connections.len();
        if count == 0 {
            return None;
        }
        let from = if count == 1 { 0 } else { host::below(count) };
        for offset in 0..count {
            let connection = &mut queue.connections[(from + offset) % count];
            if let Some(frame) = connection.frames.pop_front() {
                return Some(frame);
            }
        }
        with(self.service, |state| {
            let lives = |port: u128| state.writers.iter().any(|(other, _)| *other == port);
            queue
                .connections
                .retain(|connection| lives(connection.port));
        });
        None
    }
}

impl<H: Payload, T: Payload> Drop for Reader<H, T> {
    fn drop(&mut self) {
        let number = self.number;
        with(self.service, |state| {
            state.readers.retain(|reader| reader.number != number);
        });
    }
}

/// A frame that is kept while this value lives.
#[derive(Debug)]
pub struct KeptFrame<H: Payload, T: Payload> {
    frame: Rc<Sent<H, T>>,
}

impl<H: Payload, T: Payload> KeptFrame<H, T> {
    /// The frame's header.
    #[must_use]
    pub fn header(&self) -> &H {
        &self.frame.header
    }

    /// The frame's slice.
    #[must_use]
    pub fn payload(&self) -> &[T] {
        &self.frame.payload
    }
}

/// A frame that was received.
#[derive(Debug)]
pub struct Frame<'a, H: Payload, T: Payload> {
    sent: Rc<Sent<H, T>>,
    reader: PhantomData<&'a mut Reader<H, T>>,
}

impl<H: Payload, T: Payload> Frame<'_, H, T> {
    /// The frame's header.
    #[must_use]
    pub fn header(&self) -> &H {
        &self.sent.header
    }

    /// The frame's slice.
    #[must_use]
    pub fn payload(&self) -> &[T] {
        &self.sent.payload
    }
}

/// A frame that the worker took: its header and length.
pub type Taken = (SampleHeader, u64);

thread_local! {
    static TAKEN: RefCell<Vec<Taken>> = const { RefCell::new(Vec::new()) };
}

/// The frames that workers took since the last call.
#[must_use]
pub fn taken_frames() -> Vec<Taken> {
    TAKEN.take()
}

/// The worker's port for samples.
#[derive(Debug)]
pub struct SampleReader {
    reader: Reader<SampleHeader, Sample>,
}

impl SampleReader {
    /// The next frame.
    ///
    /// # Errors
    /// [`ReceiveError`].
    pub fn next(&mut self, most: usize) -> Result<Option<IncomingFrame<'_>>, ReceiveError> {
        let Some(sent) = self.reader.receive()? else {
            return Ok(None);
        };
        let taken = (sent.header, sent.payload.len() as u64);
        outside(|| TAKEN.with_borrow_mut(|all| all.push(taken)));
        Ok(Some(IncomingFrame {
            kept: sent.payload.len().min(most),
            sent,
            copied: 0,
            reader: PhantomData,
        }))
    }
}

/// A frame of samples that is being received.
#[derive(Debug)]
pub struct IncomingFrame<'a> {
    sent: Rc<Sent<SampleHeader, Sample>>,
    kept: usize,
    copied: usize,
    reader: PhantomData<&'a mut SampleReader>,
}

impl IncomingFrame<'_> {
    /// The header.
    #[must_use]
    pub fn header(&self) -> &SampleHeader {
        &self.sent.header
    }

    /// Number of samples that will be copied.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.kept
    }

    /// True if there are none.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.kept == 0
    }

    /// Number of samples beyond the limit.
    #[must_use]
    pub fn truncated(&self) -> usize {
        self.sent.payload.len() - self.kept
    }

    /// Copies the next samples.
    pub fn copy_part<'p>(&mut self, part: &'p mut Vec<Sample>) -> Option<&'p [Sample]> {
        let count = part.capacity().min(self.kept - self.copied);
        if count == 0 {
            return None;
        }
        let from = self.copied;
        self.copied += count;
        part.clear();
        part.extend_from_slice(&self.sent.payload[from..self.copied]);
        Some(part)
    }
}

/// A source's port.
#[derive(Debug)]
pub struct SampleWriter {
    writer: Writer<SampleHeader, Sample>,
    waker: Waker,
}

impl SampleWriter {
    /// Sends a frame of samples, and wakes the worker.
    ///
    /// # Errors
    /// [`SendError`].
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

    /// Maximum number of samples per frame.
    #[must_use]
    pub const fn max_len(&self) -> usize {
        self.writer.max_len()
    }

    /// Number of failed connections.
    #[must_use]
    pub const fn degraded(&self) -> u64 {
        self.writer.degraded()
    }
}

/// A method that opens a port, as of the real bus.
macro_rules! opens {
    ($(#[$about:meta] $name:ident -> $port:ty: $open:expr;)*) => {
        impl Bus {
            $(
                #[$about]
                ///
                /// # Errors
                /// [`OpenError`].
                pub fn $name(&self, limits: &Limits) -> Result<$port, OpenError> {
                    ($open)(self, limits)
                }
            )*
        }
    };
}

opens! {
    /// The worker's port for samples.
    sample_reader -> SampleReader: |bus, limits: &Limits| {
        Reader::open(bus, Service::Samples, limits.samples()).map(|reader| SampleReader { reader })
    };
    /// A recorder's port for samples.
    sample_tap -> SampleTap: |bus, limits: &Limits| {
        Reader::open(bus, Service::Samples, limits.samples())
    };
    /// The worker's port for forecasts.
    forecast_writer -> ForecastWriter: |bus, limits: &Limits| {
        Writer::open(bus, Service::Forecasts, limits.forecasts(), limits.capacity)
    };
    /// A planner's port for forecasts.
    forecast_reader -> ForecastReader: |bus, limits: &Limits| {
        Reader::open(bus, Service::Forecasts, limits.forecasts())
    };
    /// The worker's port for diagnostics.
    diagnostic_writer -> DiagnosticWriter: |bus, limits: &Limits| {
        Writer::open(bus, Service::Diagnostics, limits.diagnostics(), limits.capacity)
    };
    /// A planner's port for diagnostics.
    diagnostic_reader -> DiagnosticReader: |bus, limits: &Limits| {
        Reader::open(bus, Service::Diagnostics, limits.diagnostics())
    };
    /// The worker's port for budgets.
    budget_writer -> BudgetWriter: |bus, limits: &Limits| {
        Writer::open(bus, Service::Budgets, limits.budgets(), limits.capacity)
    };
    /// The worker's port for what plans start from.
    plan_state_writer -> PlanStateWriter: |bus, limits: &Limits| {
        Writer::open(bus, Service::PlanStates, limits.plan_states(), limits.capacity)
    };
    /// A planner's port for what plans start from.
    plan_state_reader -> PlanStateReader: |bus, limits: &Limits| {
        Reader::open(bus, Service::PlanStates, limits.plan_states())
    };
    /// A planner's port for budgets.
    budget_reader -> BudgetReader: |bus, limits: &Limits| {
        Reader::open(bus, Service::Budgets, limits.budgets())
    };
    /// The worker's port for its journal.
    tick_writer -> TickWriter: |bus, limits: &Limits| {
        Writer::open(bus, Service::Ticks, limits.ticks(), limits.listed_frames())
    };
    /// A recorder's port for the worker's journal.
    tick_reader -> TickReader: |bus, limits: &Limits| {
        Reader::open(bus, Service::Ticks, limits.ticks())
    };
    /// The worker's port for keyframes.
    state_writer -> StateWriter: |bus, limits: &Limits| {
        Writer::open(bus, Service::State, limits.state(), limits.state_piece_bytes())
    };
    /// A recorder's port for keyframes.
    state_reader -> StateReader: |bus, limits: &Limits| {
        Reader::open(bus, Service::State, limits.state())
    };
    /// The worker's port for records of questions.
    queries_writer -> QueriesWriter: |bus, limits: &Limits| {
        Writer::open(bus, Service::Queries, limits.queries(), joulebus_wire::RECORD_WORDS)
    };
    /// The worker's port for questions.
    query_server -> QueryServer: |bus, limits: &Limits| QueryServer::open(bus, limits);
    /// A client's port for questions.
    query_client -> QueryClient: |bus, limits: &Limits| QueryClient::open(bus, limits);
    /// A recorder's port for records of questions.
    queries_reader -> QueriesReader: |bus, limits: &Limits| {
        Reader::open(bus, Service::Queries, limits.queries())
    };
    /// Waits for samples.
    arrivals_waiter -> Waiter: |bus, _: &Limits| Waiter::open(bus, Service::Arrivals);
    /// Wakes planners.
    planner_waker -> Waker: |bus, _: &Limits| Waker::open(bus, Service::Wake);
    /// Waits for forecasts.
    planner_waiter -> Waiter: |bus, _: &Limits| Waiter::open(bus, Service::Wake);
}

impl Bus {
    /// Waits for times.
    #[must_use]
    pub fn planner_poller(&self) -> Poller {
        Poller::new(self)
    }

    /// A source's port.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn sample_writer(
        &self,
        limits: &Limits,
        max_len: usize,
    ) -> Result<SampleWriter, OpenError> {
        Ok(SampleWriter {
            writer: Writer::open(self, Service::Samples, limits.samples(), max_len)?,
            waker: Waker::open(self, Service::Arrivals)?,
        })
    }
}
