//! Questions and answers. Connections of clients do not fail; that of a client which has left with
//! a question unread is kept, as by iceoryx2 0.10.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::rc::Rc;

use joulebus_simulated_host::{self as host, memory::outside};
use joulebus_wire::{
    AnswerHeader, MAX_ANSWER_WORDS, MAX_QUERY_VALUES, QueryHeader, Service, WakeEvent,
};

use crate::liveness::worker_lock::WorkerLock;
use crate::liveness::worker_ports::WorkerPorts;
use crate::queues::port_id;
use crate::{
    Bus, Limits, OpenError, PeerWatch, QueryError, ReceiveError, SendError, Sent, WaitError,
    Waiter, Waker, clock,
};

#[path = "../../../../crates/host/bus/src/ports/connection_leak.rs"]
mod connection_leak;
use connection_leak::ConnectionLeak;

/// Connections at which iceoryx2 panics.
const MAX_KEPT: usize = 128;

/// The worker's port as clients see it.
#[derive(Debug)]
struct Server {
    port: u128,
    pid: u32,
    is_open: Cell<bool>,
    waiting: RefCell<VecDeque<Rc<Transfer>>>,
    /// Connections of clients that have left with a question unread.
    kept: Cell<usize>,
}

#[derive(Debug)]
struct Transfer {
    header: QueryHeader,
    values: Vec<f64>,
    client: (u128, u32),
    server: Rc<Server>,
    /// Its client waits for the answer.
    is_wanted: Cell<bool>,
    /// The worker has dropped it.
    is_dropped: Cell<bool>,
    answer: RefCell<Option<(AnswerHeader, Vec<u64>)>>,
}

#[derive(Default)]
struct State {
    server: Option<Rc<Server>>,
    clients: Vec<(u128, u32)>,
}

thread_local! {
    static STATE: RefCell<State> = RefCell::default();
}

fn with<T>(work: impl FnOnce(&mut State) -> T) -> T {
    outside(|| STATE.with_borrow_mut(work))
}

pub(crate) fn begin() {
    with(|state| *state = State::default());
}

pub(crate) fn size() -> usize {
    with(|state| state.clients.len() + usize::from(state.server.is_some()))
}

pub(crate) fn remove_process(pid: u32) {
    with(|state| {
        state.clients.retain(|(_, of)| *of != pid);
        if let Some(server) = &state.server {
            for transfer in &*server.waiting.borrow() {
                if transfer.client.1 == pid {
                    transfer.is_wanted.set(false);
                }
            }
        }
        if let Some(server) = state.server.take_if(|server| server.pid == pid) {
            server.is_open.set(false);
        }
    });
}

fn refused(reason: &str) -> OpenError {
    OpenError::Port { service: Service::ASK.name(), reason: reason.to_owned() }
}

/// The worker's port for questions.
#[derive(Debug)]
pub struct QueryServer {
    server: Rc<Server>,
    asked: Waiter,
    answered: Waker,
    leak: ConnectionLeak,
    bus: Bus,
}

/// A question that was received.
#[derive(Debug)]
pub struct OpenQuery {
    transfer: Rc<Transfer>,
}

impl QueryServer {
    pub(crate) fn open(bus: &Bus, limits: &Limits) -> Result<Self, OpenError> {
        let events = limits.query_events();
        let asked = Waiter::open(bus, Service::ASKED, limits, events, None)?;
        let answered = Waker::open(bus, Service::ANSWERED, limits, events)?;
        let server = outside(|| {
            Rc::new(Server {
                port: port_id(bus.pid),
                pid: bus.pid,
                is_open: Cell::new(true),
                waiting: RefCell::default(),
                kept: Cell::new(0),
            })
        });
        with(|state| match &state.server {
            Some(_) => Err(refused("ExceedsMaxSupportedServers")),
            None => {
                state.server = Some(Rc::clone(&server));
                Ok(())
            }
        })?;
        let _ = answered.wake(WakeEvent::Frame);
        Ok(Self { server, asked, answered, leak: ConnectionLeak::default(), bus: bus.clone() })
    }

    /// The next waiting question.
    pub fn receive(&mut self) -> Result<Option<OpenQuery>, ReceiveError> {
        host::operation();
        self.bus.check()?;
        loop {
            let next = self.server.waiting.borrow_mut().pop_front();
            let Some(transfer) = next else {
                return Ok(None);
            };
            if transfer.is_wanted.get() {
                return Ok(Some(OpenQuery { transfer }));
            }
            if !with(|state| state.clients.contains(&transfer.client)) {
                let kept = self.server.kept.get() + 1;
                self.server.kept.set(kept);
                assert!(kept < MAX_KEPT, "{kept} connections of clients that left are kept");
            }
        }
    }

    /// Answers a question and wakes its client.
    pub fn answer(
        &self,
        query: &OpenQuery,
        header: AnswerHeader,
        listener: u128,
        words: &[u64],
    ) -> Result<Sent, SendError> {
        host::operation();
        self.bus.check()?;
        if !host::is_dead() {
            let words = outside(|| words[..words.len().min(MAX_ANSWER_WORDS)].to_vec());
            *query.transfer.answer.borrow_mut() = Some((header, words));
        }
        let woken = self.answered.wake_one(listener, WakeEvent::Frame);
        Ok(Sent { readers: 1, not_woken: woken.err() })
    }

    pub fn wait_until(&mut self, deadline_ns: u64) -> Result<(), WaitError> {
        self.asked.wait_until(Some(deadline_ns), None).map(|_| ())
    }

    pub fn clients(&mut self) -> usize {
        let now = with(|state| state.clients.iter().map(|(port, _)| *port).collect());
        self.leak.look(now, clock::monotonic_ns())
    }

    /// True if the port is to be opened again.
    pub fn needs_reopen(&self, is_idle: bool) -> bool {
        self.leak.needs_reopen(is_idle, clock::monotonic_ns())
    }
}

impl Drop for QueryServer {
    fn drop(&mut self) {
        self.server.is_open.set(false);
        let port = self.server.port;
        with(|state| state.server.take_if(|server| server.port == port));
    }
}

impl OpenQuery {
    pub fn header(&self) -> &QueryHeader {
        &self.transfer.header
    }

    pub fn values(&self) -> &[f64] {
        &self.transfer.values
    }

    /// The process that asked.
    pub fn client(&self) -> u32 {
        self.transfer.client.1
    }

    /// False once its client has stopped waiting.
    pub fn is_connected(&self) -> bool {
        self.transfer.is_wanted.get()
    }
}

impl Drop for OpenQuery {
    fn drop(&mut self) {
        self.transfer.is_dropped.set(true);
    }
}

/// A client's port for questions.
#[derive(Debug)]
pub struct QueryClient {
    port: u128,
    pending: Option<Rc<Transfer>>,
    answered: Waiter,
    asked: Waker,
    workers: WorkerPorts,
    worker: Option<(u32, PeerWatch)>,
    number: u64,
    sent_ns: u64,
    bus: Bus,
}

impl QueryClient {
    pub(crate) fn open(bus: &Bus, limits: &Limits) -> Result<Self, OpenError> {
        let events = limits.query_events();
        let answered = Waiter::open(bus, Service::ANSWERED, limits, events, None)?;
        let asked = Waker::open(bus, Service::ASKED, limits, events)?;
        let port = port_id(bus.pid);
        with(|state| {
            if state.clients.len() == limits.query_clients() {
                return Err(refused("ExceedsMaxSupportedClients"));
            }
            state.clients.push((port, bus.pid));
            Ok(())
        })?;
        Ok(Self {
            port,
            pending: None,
            answered,
            asked,
            workers: WorkerPorts::new(&bus.domain),
            worker: None,
            number: 0,
            sent_ns: 0,
            bus: bus.clone(),
        })
    }

    /// The simulator does not block.
    pub fn ask(
        &mut self,
        _: QueryHeader,
        _: &[f64],
    ) -> Result<(AnswerHeader, Vec<u64>), QueryError> {
        Err(QueryError::Send { reason: "programs of the simulator send, and poll".to_owned() })
    }

    /// Same as in `joulebus-bus`.
    pub fn send(&mut self, header: QueryHeader, values: &[f64]) -> Result<(), QueryError> {
        host::operation();
        self.give_up();
        self.bus.check()?;
        if values.len() > MAX_QUERY_VALUES {
            return Err(QueryError::TooLong { found: values.len(), allowed: MAX_QUERY_VALUES });
        }
        let server = self.watch()?;
        self.number += 1;
        self.sent_ns = clock::monotonic_ns();
        let listener = self.answered.id();
        let client = (self.port, self.bus.pid);
        let is_unread = |transfer: &Rc<Transfer>| transfer.client == client;
        if server.waiting.borrow().iter().any(is_unread) {
            return Err(QueryError::Full);
        }
        let transfer = outside(|| {
            Rc::new(Transfer {
                header: QueryHeader {
                    number: self.number,
                    asked_ns: self.sent_ns,
                    listener_lo: listener as u64,
                    listener_hi: (listener >> 64) as u64,
                    ..header
                },
                values: values.to_vec(),
                client,
                server: Rc::clone(&server),
                is_wanted: Cell::new(true),
                is_dropped: Cell::new(false),
                answer: RefCell::default(),
            })
        });
        outside(|| server.waiting.borrow_mut().push_back(Rc::clone(&transfer)));
        self.pending = Some(transfer);
        self.asked.wake(WakeEvent::Frame)?;
        Ok(())
    }

    /// Same as in `joulebus-bus`.
    pub fn poll(
        &mut self,
        deadline_ns: u64,
    ) -> Result<Option<(AnswerHeader, Vec<u64>)>, QueryError> {
        host::operation();
        self.bus.check()?;
        let worker = self.worker.as_ref();
        let is_gone = worker.is_some_and(|(_, watch)| watch.is_gone());
        let connected =
            |transfer: &Rc<Transfer>| transfer.server.is_open.get() && !transfer.is_dropped.get();
        let is_closed = !self.pending.as_ref().is_some_and(connected);
        let now_ns = clock::monotonic_ns();
        let polled = match self.receive() {
            None if is_gone => {
                self.worker = None;
                Err(QueryError::WorkerGone)
            }
            None if is_closed => Err(QueryError::NotServed),
            None if now_ns >= deadline_ns => {
                Err(QueryError::TimedOut { waited_ns: now_ns.saturating_sub(self.sent_ns) })
            }
            received => Ok(received),
        };
        match polled {
            Ok(None) => self.sleep(deadline_ns)?,
            _ => self.give_up(),
        }
        polled
    }

    /// The process sleeps until it is woken.
    fn sleep(&mut self, deadline_ns: u64) -> Result<(), QueryError> {
        let peer = self.worker.as_ref().map(|(_, watch)| watch);
        self.answered.wait_until(Some(deadline_ns), peer)?;
        Ok(())
    }

    fn receive(&mut self) -> Option<(AnswerHeader, Vec<u64>)> {
        let transfer = self.pending.as_ref()?;
        let answer = transfer.answer.borrow_mut().take()?;
        let is_its = answer.0.number == self.number;
        (self.workers.admits(transfer.server.port) && is_its).then_some(answer)
    }

    fn give_up(&mut self) {
        if let Some(transfer) = self.pending.take() {
            transfer.is_wanted.set(false);
        }
    }

    fn watch(&mut self) -> Result<Rc<Server>, QueryError> {
        let file = self.bus.domain.worker_file();
        let named = || WorkerLock::named_owner(&file);
        let owner = named().ok_or(QueryError::NoWorker)?;
        let is_watched = |(of, watch): &(u32, PeerWatch)| *of == owner.pid && !watch.is_gone();
        if !self.worker.as_ref().is_some_and(is_watched) {
            self.worker = PeerWatch::open(owner.pid).map(|watch| (owner.pid, watch));
            let lives = |(_, watch): &(u32, PeerWatch)| !watch.is_gone();
            if !(self.worker.as_ref().is_some_and(lives) && named() == Some(owner)) {
                self.worker = None;
                return Err(QueryError::NoWorker);
            }
        }
        let server = with(|state| state.server.clone());
        server.filter(|server| server.pid == owner.port_pid).ok_or(QueryError::NotServed)
    }
}

impl Drop for QueryClient {
    fn drop(&mut self) {
        self.give_up();
        let port = self.port;
        with(|state| state.clients.retain(|(of, _)| *of != port));
    }
}
