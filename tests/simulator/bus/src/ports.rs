//! Ports: queues of frames.

use std::any::Any;
use std::cell::RefCell;
use std::marker::PhantomData;
use std::rc::Rc;

use joulebus_simulated_host::{self as host, memory::outside};
use joulebus_wire::{Channel, Flow, Sample, SampleHeader, Samples, Service, WakeEvent};

use crate::liveness::worker_ports::WorkerPorts;
use crate::query::{QueryClient, QueryServer};
use crate::queues::{Connection, Listed, Queue, Sent, port_id, with};
use crate::{Bus, Limits, OpenError, Poller, ReceiveError, SendError, Waiter, Waker};

/// The limit of the real reader.
const MAX_PASSED_OVER: u32 = 4_096;

fn refused(service: Service, reason: &str) -> OpenError {
    OpenError::Port { service: service.name(), reason: reason.to_owned() }
}

/// Sends frames.
#[derive(Debug)]
pub struct Writer<C: Channel> {
    port: u128,
    max_len: usize,
    /// The last frame, for readers that join later.
    history: Option<Rc<Sent<C>>>,
    keeps_history: bool,
    bus: Bus,
}

impl<C: Channel> Writer<C> {
    fn open(bus: &Bus, limits: &Limits, max_len: usize) -> Result<Self, OpenError> {
        let (service, shape) = (C::SERVICE, limits.shape(C::FLOW));
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
        header: C::Header,
        len: usize,
        element: impl FnMut(usize) -> C::Row,
    ) -> Result<usize, SendError> {
        self.check(len)?;
        let payload = outside(|| (0..len).map(element).collect());
        Ok(self.deliver(header, payload))
    }

    /// Memory for a frame of `len` elements.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn loan_to_fill(&mut self, len: usize) -> Result<Loan<'_, C>, SendError> {
        self.check(len)?;
        Ok(Loan {
            header: C::Header::default(),
            payload: outside(|| vec![C::Row::default(); len]),
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
            if let Ok(queue) = queue.downcast::<RefCell<Queue<C>>>() {
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
    pub fn readers(&self) -> usize {
        with(C::SERVICE, |state| state.readers.len())
    }

    /// Maximum number of elements per frame.
    pub const fn max_len(&self) -> usize {
        self.max_len
    }

    /// Connections of a writer do not fail.
    pub const fn degraded(&self) -> u64 {
        0
    }

    fn check(&self, len: usize) -> Result<(), SendError> {
        host::operation();
        self.bus.check()?;
        if len > self.max_len {
            return Err(SendError::TooLong { found: len, allowed: self.max_len });
        }
        Ok(())
    }

    fn deliver(&mut self, header: C::Header, payload: Vec<C::Row>) -> usize {
        host::operation();
        if host::is_dead() {
            return 0;
        }
        let frame = outside(|| Rc::new(Sent { header, payload, port: self.port }));
        let mut reached = 0;
        for (pid, queue) in self.queues() {
            // A process of another version would be refused by iceoryx2.
            if let Ok(queue) = queue.downcast::<RefCell<Queue<C>>>() {
                let is_reached = outside(|| self.push(&frame, pid, &mut queue.borrow_mut()));
                reached += usize::from(is_reached);
            }
        }
        self.history = self.keeps_history.then_some(frame);
        reached
    }

    /// The readers' queues, each with the reader's process.
    fn queues(&self) -> Vec<(u32, Rc<dyn Any>)> {
        with(C::SERVICE, |state| {
            let readers = state.readers.iter();
            readers.map(|reader| (reader.pid, Rc::clone(&reader.queue))).collect()
        })
    }

    /// Puts a frame into the queue of a reader of process `pid`; the oldest is overwritten.
    fn push(&self, frame: &Rc<Sent<C>>, pid: u32, queue: &mut Queue<C>) -> bool {
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

impl<C: Channel> Drop for Writer<C> {
    fn drop(&mut self) {
        with(C::SERVICE, |state| {
            state.writers.retain(|(port, _)| *port != self.port);
        });
    }
}

/// Memory of a frame to send.
#[derive(Debug)]
pub struct Loan<'a, C: Channel> {
    header: C::Header,
    payload: Vec<C::Row>,
    writer: &'a mut Writer<C>,
}

impl<C: Channel> Loan<'_, C> {
    /// The frame's header.
    pub const fn header_mut(&mut self) -> &mut C::Header {
        &mut self.header
    }

    /// The frame's slice.
    pub fn payload_mut(&mut self) -> &mut [C::Row] {
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
pub struct Reader<C: Channel> {
    number: u64,
    held: Option<Rc<Sent<C>>>,
    queue: Rc<RefCell<Queue<C>>>,
    /// Frames that can be queued at once, of all writers.
    queued: usize,
    worker: Option<WorkerPorts>,
    bus: Bus,
}

impl<C: Channel> Reader<C> {
    fn open(bus: &Bus, limits: &Limits) -> Result<Self, OpenError> {
        let (service, shape) = (C::SERVICE, limits.shape(C::FLOW));
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
            state.readers.push(Listed { number, pid: bus.pid, queue: Rc::clone(&queue) as _ });
            Ok(())
        })?;
        Ok(Self {
            number,
            held: None,
            queue,
            queued: shape.buffer * shape.publishers,
            worker: (C::FLOW != Flow::Sources).then(|| WorkerPorts::new(&bus.domain)),
            bus: bus.clone(),
        })
    }

    /// Calls `each` for all queued frames.
    ///
    /// # Errors
    /// [`ReceiveError`].
    pub fn take_all(
        &mut self,
        mut each: impl FnMut(&C::Header, &[C::Row]),
    ) -> Result<(), ReceiveError> {
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
    pub fn take_latest(&mut self) -> Result<Option<Frame<'_, C>>, ReceiveError> {
        let mut latest = None;
        while let Some(newer) = self.receive()? {
            latest = Some(newer);
        }
        Ok(latest.map(|sent| Frame { sent, reader: PhantomData }))
    }

    /// Holds the last frame that is `newer` than the held one.
    ///
    /// # Errors
    /// [`ReceiveError`].
    pub fn hold_latest(
        &mut self,
        mut newer: impl FnMut(&C::Header, &[C::Row], u64) -> bool,
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
    pub fn held(&self) -> Option<(&C::Header, &[C::Row])> {
        let held = self.held.as_ref()?;
        Some((&held.header, &held.payload))
    }

    /// Moves the frame of [`Reader::held`] out of the reader.
    pub fn take_held(&mut self) -> Option<KeptFrame<C>> {
        let frame = self.held.take()?;
        Some(KeptFrame { frame })
    }

    /// Number of failed connections.
    pub fn degraded(&self) -> u64 {
        self.queue.borrow().failed
    }

    /// Number of frames of others than the worker.
    pub fn foreign(&self) -> u64 {
        self.worker.as_ref().map_or(0, WorkerPorts::foreign)
    }

    fn receive(&mut self) -> Result<Option<Rc<Sent<C>>>, ReceiveError> {
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
            if passed_over == MAX_PASSED_OVER {
                return Ok(None);
            }
        }
    }

    /// The oldest frame of one of the writers, any of them.
    fn pop(&mut self) -> Option<Rc<Sent<C>>> {
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
        with(C::SERVICE, |state| {
            let lives = |port: u128| state.writers.iter().any(|(other, _)| *other == port);
            queue.connections.retain(|connection| lives(connection.port));
        });
        None
    }
}

impl<C: Channel> Drop for Reader<C> {
    fn drop(&mut self) {
        let number = self.number;
        with(C::SERVICE, |state| {
            state.readers.retain(|reader| reader.number != number);
        });
    }
}

/// A frame that is kept while this value lives.
#[derive(Debug)]
pub struct KeptFrame<C: Channel> {
    frame: Rc<Sent<C>>,
}

impl<C: Channel> KeptFrame<C> {
    /// The frame's header.
    pub fn header(&self) -> &C::Header {
        &self.frame.header
    }

    /// The frame's slice.
    pub fn payload(&self) -> &[C::Row] {
        &self.frame.payload
    }
}

/// A frame that was received.
#[derive(Debug)]
pub struct Frame<'a, C: Channel> {
    sent: Rc<Sent<C>>,
    reader: PhantomData<&'a mut Reader<C>>,
}

impl<C: Channel> Frame<'_, C> {
    /// The frame's header.
    pub fn header(&self) -> &C::Header {
        &self.sent.header
    }

    /// The frame's slice.
    pub fn payload(&self) -> &[C::Row] {
        &self.sent.payload
    }
}

/// A frame that the worker took: its header and length.
pub type Taken = (SampleHeader, u64);

thread_local! {
    static TAKEN: RefCell<Vec<Taken>> = const { RefCell::new(Vec::new()) };
}

/// The frames that workers took since the last call.
pub fn taken_frames() -> Vec<Taken> {
    TAKEN.take()
}

/// The worker's port for samples.
#[derive(Debug)]
pub struct SampleReader {
    reader: Reader<Samples>,
}

impl SampleReader {
    /// Copies the next frame. False if there is none.
    ///
    /// # Errors
    /// [`ReceiveError`].
    pub fn take(&mut self, frame: &mut FrameBuf) -> Result<bool, ReceiveError> {
        let Some(mut incoming) = self.next(frame.samples.capacity())? else {
            return Ok(false);
        };
        frame.header = *incoming.header();
        frame.samples.clear();
        incoming.copy_part(&mut frame.samples);
        Ok(true)
    }

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

/// A private copy of a frame of samples.
#[derive(Debug)]
pub struct FrameBuf {
    header: SampleHeader,
    samples: Vec<Sample>,
}

impl FrameBuf {
    /// A buffer for frames of up to `capacity` samples.
    pub fn new(capacity: usize) -> Self {
        Self { header: SampleHeader::default(), samples: Vec::with_capacity(capacity) }
    }

    /// The header.
    pub const fn header(&self) -> &SampleHeader {
        &self.header
    }

    /// The samples, at most the capacity.
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }
}

/// A frame of samples that is being received.
#[derive(Debug)]
pub struct IncomingFrame<'a> {
    sent: Rc<Sent<Samples>>,
    kept: usize,
    copied: usize,
    reader: PhantomData<&'a mut SampleReader>,
}

impl IncomingFrame<'_> {
    /// The header.
    pub fn header(&self) -> &SampleHeader {
        &self.sent.header
    }

    /// Number of samples that will be copied.
    pub const fn len(&self) -> usize {
        self.kept
    }

    /// True if there are none.
    pub const fn is_empty(&self) -> bool {
        self.kept == 0
    }

    /// Number of samples beyond the limit.
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
    writer: Writer<Samples>,
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
    ) -> Result<crate::Sent, SendError> {
        Ok(crate::Sent {
            readers: self.writer.send(header, len, sample)?,
            not_woken: self.waker.wake(WakeEvent::Frame).err(),
        })
    }

    /// Maximum number of samples per frame.
    pub const fn max_len(&self) -> usize {
        self.writer.max_len()
    }

    /// Number of failed connections.
    pub const fn degraded(&self) -> u64 {
        self.writer.degraded()
    }
}

impl Bus {
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
            writer: Writer::open(self, limits, max_len)?,
            waker: Waker::open(self, Service::ARRIVALS)?,
        })
    }

    /// The worker's port for samples.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn sample_reader(&self, limits: &Limits) -> Result<SampleReader, OpenError> {
        self.reader(limits).map(|reader| SampleReader { reader })
    }

    /// Reads a channel.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn reader<C: Channel>(&self, limits: &Limits) -> Result<Reader<C>, OpenError> {
        Reader::open(self, limits)
    }

    /// Writes a channel.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn writer<C: Channel>(&self, limits: &Limits) -> Result<Writer<C>, OpenError> {
        Writer::open(self, limits, limits.rows(C::ROWS))
    }

    /// The worker's port for questions.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn query_server(&self, limits: &Limits) -> Result<QueryServer, OpenError> {
        QueryServer::open(self, limits)
    }

    /// A client's port for questions.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn query_client(&self, limits: &Limits) -> Result<QueryClient, OpenError> {
        QueryClient::open(self, limits)
    }

    /// Waits for samples.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn arrivals_waiter(&self, _: &Limits) -> Result<Waiter, OpenError> {
        Waiter::open(self, Service::ARRIVALS)
    }

    /// Wakes planners.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn planner_waker(&self, _: &Limits) -> Result<Waker, OpenError> {
        Waker::open(self, Service::WAKE)
    }

    /// Waits for forecasts.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn planner_waiter(&self, _: &Limits) -> Result<Waiter, OpenError> {
        Waiter::open(self, Service::WAKE)
    }

    /// Waits for times.
    pub fn planner_poller(&self) -> Poller {
        Poller::new(self)
    }
}
