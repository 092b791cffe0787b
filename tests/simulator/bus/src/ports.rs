//! Ports: queues of frames.

#[path = "../../../../crates/host/bus/src/ports/open.rs"]
mod open;
#[path = "../../../../crates/host/bus/src/ports/reading.rs"]
mod reading;
#[path = "../../../../crates/host/bus/src/ports/samples.rs"]
mod samples;

use std::any::Any;
use std::cell::RefCell;
use std::rc::Rc;

use joulebus_simulated_host::{self as host, memory::outside};
use joulebus_wire::{Channel, Flow, SampleHeader, Samples, Service};

use crate::liveness::worker_ports::WorkerPorts;
use crate::queues::{Connection, Listed, Queue, Sent, port_id, with};
use crate::{Bus, Limits, OpenError, ReceiveError, SendError};

pub use reading::Frame;
pub use samples::{FrameBuf, IncomingFrame, SampleReader, SampleWriter};

type Received<C> = Rc<Sent<C>>;
/// A frame keeps no membership.
#[derive(Debug, Clone)]
struct Member;

/// The limit of the real reader.
const MAX_PASSED_OVER: u32 = 4_096;

fn refused(service: Service, reason: &str) -> OpenError {
    OpenError::Port { service: service.name(), reason: reason.to_owned() }
}

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
    pub const fn header_mut(&mut self) -> &mut C::Header {
        &mut self.header
    }

    pub fn payload_mut(&mut self) -> &mut [C::Row] {
        &mut self.payload
    }

    pub fn send(self) -> Result<usize, SendError> {
        Ok(self.writer.deliver(self.header, self.payload))
    }
}

#[derive(Debug)]
pub struct Reader<C: Channel> {
    number: u64,
    held: Option<Received<C>>,
    queue: Rc<RefCell<Queue<C>>>,
    /// Frames that can be queued at once, of all writers.
    queued: usize,
    worker: Option<WorkerPorts>,
    member: Member,
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
            member: Member,
            bus: bus.clone(),
        })
    }

    /// Number of failed connections.
    pub fn degraded(&self) -> u64 {
        self.queue.borrow().failed
    }

    const fn queued(&self) -> usize {
        self.queued
    }

    const fn worker(&self) -> Option<&WorkerPorts> {
        self.worker.as_ref()
    }

    const fn member(&self) -> &Member {
        &self.member
    }

    fn receive(&mut self) -> Result<Option<Received<C>>, ReceiveError> {
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
    fn pop(&mut self) -> Option<Received<C>> {
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

/// A frame that was taken: its header and length.
pub type Taken = (SampleHeader, u64);

thread_local! {
    /// Each with the process that took it.
    static TAKEN: RefCell<Vec<(u32, Taken)>> = const { RefCell::new(Vec::new()) };
}

/// The frames that the worker, process `pid`, took since the last call.
pub fn taken_frames(pid: u32) -> Vec<Taken> {
    let all = TAKEN.take().into_iter();
    all.filter(|(of, _)| *of == pid).map(|(_, taken)| taken).collect()
}

/// Watches a port of samples.
#[derive(Debug, Clone)]
pub struct WriterWatch(u128);

impl WriterWatch {
    const fn new(_: &Member, port: u128) -> Self {
        Self(port)
    }

    /// True while the port can send frames.
    pub fn is_open(&self) -> bool {
        with(Samples::SERVICE, |state| state.writers.iter().any(|(port, _)| *port == self.0))
    }
}

/// Notes each frame that is taken: by the worker, or by a view.
#[derive(Debug)]
struct Noted;

impl Noted {
    const fn new() -> Self {
        Self
    }

    fn note(&mut self, sent: &Received<Samples>) {
        let taken = (host::current(), (sent.header, sent.payload.len() as u64));
        outside(|| TAKEN.with_borrow_mut(|all| all.push(taken)));
    }
}

/// Places have no limit for planners.
#[derive(Debug)]
pub(crate) struct OpenPlaces;

impl OpenPlaces {
    const fn new(_: &Limits, _: Flow) -> Self {
        Self
    }
}
