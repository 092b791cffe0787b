//! Questions and answers: iceoryx2's request-response, and an event for each direction.
//!
//! A client has one question in transfer at a time. Full queues refuse instead of blocking, and
//! memory is fixed when a port is opened. A client learns from the worker's lock, not from
//! iceoryx2, whose answers to take and that the worker has ended.
//!
//! iceoryx2 0.10 never gives back the connection of a client that left while its question was
//! unread: `Server::receive` finds no port for the answer, and does not release the request. That
//! costs two descriptors and the client's memory, and 128 such connections are a panic. So the
//! server's port is opened again before that ([`QueryServer::needs_reopen`]), and clients send an
//! unanswered question again.

use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

use iceoryx2::active_request::ActiveRequest;
use iceoryx2::pending_response::PendingResponse;
use iceoryx2::port::DegradationAction;
use iceoryx2::port::client::Client;
use iceoryx2::port::server::Server;
use iceoryx2::prelude::{AllocationStrategy, BackpressureStrategy, CallbackProgression};
use iceoryx2::service::port_factory::PortFactory as _;
use iceoryx2::service::port_factory::client::ClientCreateError;
use joulebus_wire::{
    AnswerHeader, MAX_ANSWER_WORDS, MAX_QUERY_VALUES, QueryHeader, Service, WakeEvent,
};

use super::connection_leak::ConnectionLeak;
use super::degradation::Failures;
use super::places::OpenPlaces;
use super::repair::Repair;
use super::service::{self, OpenError, QueryFactory};
use super::wait::{WaitError, Waiter, Waker};
use super::{ReceiveError, SendError, Sent};
use crate::bus::OPERATORS;
use crate::ipc::Ipc;
use crate::liveness::guarded::{DropsHere, Guarded};
use crate::liveness::worker_lock::{Owner, WorkerLock};
use crate::liveness::worker_ports::{WorkerPorts, process_of};
use crate::membership::Membership;
use crate::os::fork::ForkSection;
use crate::os::memory;
use crate::preflight::{check_memory, client_bytes, server_bytes};
use crate::{Bus, Domain, FilesRemoved, Limits, PeerWatch, clock};

type ServerPort = (Server<Ipc, [f64], QueryHeader, [u64], AnswerHeader>, QueryFactory);
type ClientPort = (Client<Ipc, [f64], QueryHeader, [u64], AnswerHeader>, QueryFactory);

type Pending = DropsHere<PendingResponse<Ipc, [f64], QueryHeader, [u64], AnswerHeader>>;
type Request = DropsHere<ActiveRequest<Ipc, [f64], QueryHeader, [u64], AnswerHeader>>;

/// A worker may take this long to open its port, ns: it may be waiting for a processor.
const OPENS_WITHIN_NS: u64 = 3_000_000_000;
/// Pause before a question is sent again.
const SEND_RETRY_AFTER: Duration = Duration::from_millis(1);

/// The worker's port for questions. A fleet has one.
#[derive(Debug)]
pub struct QueryServer {
    // Dropped in this order: port, factory, membership.
    port: Guarded<ServerPort>,
    asked: Waiter,
    answered: Waker,
    failures: Arc<Failures>,
    repair: Repair,
    leak: ConnectionLeak,
    member: Rc<Membership>,
}

/// A question that was received. Its client could still change it: copy it before checking it.
#[derive(Debug)]
pub struct OpenQuery {
    // Dropped in this order.
    request: Request,
    /// While it is dropped: the last question may drop the server's port, and its node.
    section: Option<ForkSection>,
    _member: Rc<Membership>,
}

impl QueryServer {
    pub(super) fn open(bus: &Bus, limits: &Limits) -> Result<Self, OpenError> {
        let needed = server_bytes(limits.query_clients());
        check_memory(usize::try_from(needed).unwrap_or(usize::MAX))?;
        let events = limits.query_events();
        // The waiter first: a question that arrives in between is found without an event.
        let asked = Waiter::open(bus, Service::ASKED, limits, (events.1, events.0), None)?;
        let answered = Waker::open(bus, Service::ANSWERED, limits, events)?;
        let factory = service::open_queries(bus, limits)?;
        let failures = Failures::new();
        let server = factory
            .server_builder()
            .initial_max_slice_len(MAX_ANSWER_WORDS)
            .allocation_strategy(AllocationStrategy::Static)
            .max_loaned_responses_per_request(1)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .set_request_degradation_handler(failures.handler(|info| info.sender_port_id))
            .set_response_degradation_handler(|_, _| DegradationAction::Ignore)
            .create()
            .map_err(|reason| OpenError::port(Service::ASK, reason))?;
        service::check_shortage()?;
        let id = server.id().value();
        memory::populate(&id.to_string());
        let need = service::need(&bus.member, &factory, Some(id));
        // Clients whose question the earlier port took send it again. Those not woken, later.
        let _ = answered.wake(WakeEvent::Frame);
        Ok(Self {
            port: Guarded::new((server, factory), need),
            asked,
            answered,
            failures,
            repair: Repair::default(),
            leak: ConnectionLeak::default(),
            member: Rc::clone(&bus.member),
        })
    }

    /// The next waiting question. No order among clients is promised: receive as many as clients
    /// can have in transfer, and choose. Questions whose client has stopped waiting are skipped.
    ///
    /// # Errors
    /// [`ReceiveError::Degraded`]: open the port again. After other errors the next call may work.
    pub fn receive(&mut self) -> Result<Option<OpenQuery>, ReceiveError> {
        self.member.presence.check()?;
        let (server, factory) = &*self.port;
        let failed = self.failures.count();
        let is_listed = || {
            self.failures.are_listed(|each| {
                factory.dynamic_config().list_clients(|client| {
                    each(client.client_id.value());
                    CallbackProgression::Continue
                });
            })
        };
        if self.repair.is_due(failed, clock::monotonic_ns, is_listed) {
            self.repair.retried(failed, false);
            return Err(ReceiveError::Degraded { connections: failed });
        }
        let received = match server.receive() {
            // All that wait are of clients with an earlier question that is still held.
            Err(iceoryx2::port::ReceiveError::ExceedsMaxBorrows) => None,
            received => {
                received.map_err(|reason| ReceiveError::Receive { reason: reason.to_string() })?
            }
        };
        Ok(received.map(|request| OpenQuery {
            request: DropsHere::new(request),
            _member: Rc::clone(&self.member),
            section: None,
        }))
    }

    /// Answers a question and wakes its client. The words beyond [`MAX_ANSWER_WORDS`] are not sent.
    ///
    /// # Errors
    /// [`SendError`]. Nothing was sent.
    pub fn answer(
        &self,
        query: &OpenQuery,
        header: AnswerHeader,
        listener: u128,
        words: &[u64],
    ) -> Result<Sent, SendError> {
        self.member.presence.check()?;
        let words = &words[..words.len().min(MAX_ANSWER_WORDS)];
        let loan = query.request.loan_slice_uninit(words.len());
        let mut response = loan.map_err(SendError::loan)?.write_from_slice(words);
        *response.user_header_mut() = header;
        response.send().map_err(SendError::send)?;
        let woken = self.answered.wake_one(listener, WakeEvent::Frame);
        Ok(Sent { readers: 1, not_woken: woken.err() })
    }

    /// Waits for questions, at most until `deadline_ns` (monotonic), and at most 100 ms.
    ///
    /// # Errors
    /// As [`Waiter::wait_until`].
    pub fn wait_until(&mut self, deadline_ns: u64) -> Result<(), WaitError> {
        self.asked.wait_until(Some(deadline_ns), None).map(|_| ())
    }

    /// Number of clients. A killed one counts until the cleanup. To be asked before each round of
    /// [`QueryServer::receive`], because it notices who has left.
    pub fn clients(&mut self) -> usize {
        let mut now = Vec::new();
        self.port.1.dynamic_config().list_clients(|client| {
            now.push(client.client_id.value());
            CallbackProgression::Continue
        });
        self.leak.look(now, clock::monotonic_ns())
    }

    /// True if connections of clients that have left may be kept for nothing: drop all questions
    /// and the port, and open it again. `is_idle`: no question waits.
    #[must_use]
    pub fn needs_reopen(&self, is_idle: bool) -> bool {
        self.leak.needs_reopen(is_idle, clock::monotonic_ns())
    }
}

impl OpenQuery {
    /// Its header.
    pub fn header(&self) -> &QueryHeader {
        self.request.user_header()
    }

    /// Its values.
    pub fn values(&self) -> &[f64] {
        self.request.payload()
    }

    /// The process that asked.
    pub fn client(&self) -> u32 {
        process_of(self.request.origin().value())
    }

    /// False once its client has stopped waiting. True of a killed one until the cleanup.
    pub fn is_connected(&self) -> bool {
        self.request.is_connected()
    }
}

impl Drop for OpenQuery {
    fn drop(&mut self) {
        self.section = Some(ForkSection::enter());
    }
}

/// A client's port for questions.
#[derive(Debug)]
pub struct QueryClient {
    // Dropped in this order: question in transfer, port, factory, membership.
    pending: Option<Pending>,
    port: Guarded<ClientPort>,
    answered: Waiter,
    asked: Waker,
    workers: WorkerPorts,
    domain: Domain,
    worker: Option<(Owner, PeerWatch)>,
    /// The worker whose port has taken a question last.
    taken_by: Option<u32>,
    number: u64,
    /// When the question in transfer was sent, monotonic ns.
    sent_ns: u64,
    member: Rc<Membership>,
}

impl QueryClient {
    pub(super) fn open(bus: &Bus, limits: &Limits) -> Result<Self, OpenError> {
        let needed = client_bytes();
        check_memory(usize::try_from(needed).unwrap_or(usize::MAX))?;
        let events = limits.query_events();
        // The first of a client's three ports: who finds no place makes none of them.
        let open = OpenPlaces { places: limits.open_query_clients(), own: OPERATORS };
        let answered = Waiter::open(bus, Service::ANSWERED, limits, events, Some(open))?;
        let asked = Waker::open(bus, Service::ASKED, limits, (events.1, events.0))?;
        let factory = service::open_queries(bus, limits)?;
        let create = || {
            factory
                .client_builder()
                .initial_max_slice_len(MAX_QUERY_VALUES)
                .allocation_strategy(AllocationStrategy::Static)
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .set_request_degradation_handler(|_, _| DegradationAction::Ignore)
                .set_response_degradation_handler(|_, _| DegradationAction::Ignore)
                .create()
        };
        let is_full = |error: &_| matches!(error, ClientCreateError::ExceedsMaxSupportedClients);
        let client = service::create(bus, create, is_full)
            .map_err(|reason| OpenError::port(Service::ASK, reason))?;
        service::check_shortage()?;
        let id = client.id().value();
        memory::populate(&id.to_string());
        let need = service::need(&bus.member, &factory, Some(id));
        Ok(Self {
            pending: None,
            port: Guarded::new((client, factory), need),
            answered,
            asked,
            workers: WorkerPorts::new(bus.domain()),
            domain: bus.domain().clone(),
            worker: None,
            taken_by: None,
            number: 0,
            sent_ns: 0,
            member: Rc::clone(&bus.member),
        })
    }

    /// Asks, and waits for the answer until `header.deadline_ns`, at most. Sets number, time and
    /// listener of the header. Returns the answer's header and words. Of a refused question too. A
    /// worker that has just opened its port, or opens it again, is asked once more.
    ///
    /// # Errors
    /// [`QueryError`]: at once if there is no worker, or it has ended since.
    /// [`QueryError::NotServed`] after 3 s if this worker has taken no question so far.
    pub fn ask(
        &mut self,
        header: QueryHeader,
        values: &[f64],
    ) -> Result<(AnswerHeader, Vec<u64>), QueryError> {
        let opens_ns = clock::monotonic_ns().saturating_add(OPENS_WITHIN_NS);
        loop {
            let sent = self.send(header, values);
            let worker = self.worker.as_ref().map(|(owner, _)| owner.pid);
            if sent.is_ok() {
                self.taken_by = worker;
            }
            let asked = sent.and_then(|()| self.wait(header.deadline_ns));
            if matches!(asked, Err(QueryError::NotServed)) {
                let has_taken = worker.is_some() && self.taken_by == worker;
                let until_ns = if has_taken { u64::MAX } else { opens_ns };
                if clock::monotonic_ns() < header.deadline_ns.min(until_ns) {
                    std::thread::sleep(SEND_RETRY_AFTER);
                    continue;
                }
            }
            return asked;
        }
    }

    /// As [`QueryClient::ask`], without waiting. Gives up an earlier question.
    ///
    /// # Errors
    /// [`QueryError`].
    pub fn send(&mut self, header: QueryHeader, values: &[f64]) -> Result<(), QueryError> {
        self.pending = None;
        self.member.presence.check()?;
        if values.len() > MAX_QUERY_VALUES {
            return Err(QueryError::TooLong { found: values.len(), allowed: MAX_QUERY_VALUES });
        }
        self.watch()?;
        self.number += 1;
        self.sent_ns = clock::monotonic_ns();
        let listener = self.answered.id();
        let loan = self.port.0.loan_slice_uninit(values.len());
        let mut request = loan
            .map_err(|reason| QueryError::Send { reason: reason.to_string() })?
            .write_from_slice(values);
        *request.user_header_mut() = QueryHeader {
            number: self.number,
            asked_ns: self.sent_ns,
            listener_lo: listener as u64,
            listener_hi: (listener >> 64) as u64,
            ..header
        };
        let pending =
            request.send().map_err(|reason| QueryError::Send { reason: reason.to_string() })?;
        if pending.number_of_server_connections() == 0 {
            return Err(self.not_taken());
        }
        self.pending = Some(DropsHere::new(pending));
        self.asked.wake(WakeEvent::Frame)?;
        Ok(())
    }

    /// Waits for the answer to the question sent last.
    ///
    /// # Errors
    /// As of [`QueryClient::poll`].
    pub fn wait(&mut self, deadline_ns: u64) -> Result<(AnswerHeader, Vec<u64>), QueryError> {
        loop {
            if let Some(answer) = self.poll(deadline_ns)? {
                return Ok(answer);
            }
            let peer = self.worker.as_ref().map(|(_, watch)| watch);
            self.answered.wait_until(Some(deadline_ns), peer)?;
        }
    }

    /// The answer to the question sent last, if it has arrived. Without waiting.
    ///
    /// # Errors
    /// [`QueryError`]. The question is given up. [`QueryError::TimedOut`] from `deadline_ns` on.
    pub fn poll(
        &mut self,
        deadline_ns: u64,
    ) -> Result<Option<(AnswerHeader, Vec<u64>)>, QueryError> {
        self.member.presence.check()?;
        let received = self.receive();
        if !matches!(received, Ok(None)) {
            self.pending = None;
            return received;
        }
        let worker = self.worker.as_ref();
        let is_gone = worker.is_some_and(|(_, watch)| watch.is_gone());
        let connected = |pending: &Pending| pending.is_connected();
        let is_closed = !self.pending.as_ref().is_some_and(connected);
        let now_ns = clock::monotonic_ns();
        // After the looks: it may have answered before it ended.
        let polled = match self.receive() {
            Ok(None) if is_gone => {
                self.worker = None;
                Err(QueryError::WorkerGone)
            }
            // The worker has closed its port, and does not answer any more.
            Ok(None) if is_closed => Err(QueryError::NotServed),
            Ok(None) if now_ns >= deadline_ns => {
                Err(QueryError::TimedOut { waited_ns: now_ns.saturating_sub(self.sent_ns) })
            }
            received => received,
        };
        if !matches!(polled, Ok(None)) {
            self.pending = None;
        }
        polled
    }

    /// The answer, if it has arrived from the worker.
    fn receive(&mut self) -> Result<Option<(AnswerHeader, Vec<u64>)>, QueryError> {
        let Some(pending) = &self.pending else {
            return Ok(None);
        };
        loop {
            let received = pending
                .receive()
                .map_err(|reason| QueryError::Send { reason: reason.to_string() })?;
            let Some(response) = received else {
                return Ok(None);
            };
            let header = *response.user_header();
            if self.workers.admits(response.origin().value()) && header.number == self.number {
                return Ok(Some((header, response.payload().to_vec())));
            }
        }
    }

    /// Watches the process that holds the worker's lock. No look-up while it serves the port for
    /// questions: a fleet has one such port, closed before another process may be the worker.
    fn watch(&mut self) -> Result<(), QueryError> {
        let worker = self.worker.as_ref();
        let serves =
            |(of, watch): &(Owner, PeerWatch)| self.is_served_by(of.port_pid) && !watch.is_gone();
        if worker.is_some_and(serves) {
            return Ok(());
        }
        let file = self.domain.worker_file();
        let named = || WorkerLock::named_owner(&file);
        let owner = named().ok_or(QueryError::NoWorker)?;
        let is_watched = |(of, watch): &(Owner, PeerWatch)| *of == owner && !watch.is_gone();
        if !self.worker.as_ref().is_some_and(is_watched) {
            self.worker = PeerWatch::open(owner.pid).map(|watch| (owner, watch));
            let is_alive = match &self.worker {
                // The pid may have been reused since the file was read.
                Some((_, watch)) => !watch.is_gone() && named() == Some(owner),
                // Ended, or a process of another container.
                None => matches!(WorkerLock::owner(&self.domain), Ok(Some(_))),
            };
            if !is_alive {
                self.worker = None;
                return Err(QueryError::NoWorker);
            }
        }
        if self.is_served_by(owner.port_pid) { Ok(()) } else { Err(QueryError::NotServed) }
    }

    /// True if the port for questions is that of this process. iceoryx2 takes the port of a killed
    /// worker for connected until its cleanup: a question sent there would never be answered.
    fn is_served_by(&self, process: u32) -> bool {
        let mut is_its = false;
        self.port.1.dynamic_config().list_servers(|server| {
            is_its |= process_of(server.server_id.value()) == process;
            CallbackProgression::Continue
        });
        is_its
    }

    fn not_taken(&self) -> QueryError {
        if self.port.1.dynamic_config().number_of_servers() == 0 {
            QueryError::NotServed
        } else {
            QueryError::Full
        }
    }
}

/// Reason that a question has no answer.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum QueryError {
    /// Files of this process were removed.
    #[error(transparent)]
    Removed(#[from] FilesRemoved),
    /// There is no worker.
    #[error(
        "the fleet has no worker: start it (`joulebus run --config …`). If another user runs it, \
         `joulebus doctor` says who"
    )]
    NoWorker,
    /// The worker has ended while it was asked.
    #[error("the worker ended before it answered: ask again when it has been started again")]
    WorkerGone,
    /// The worker does not answer questions.
    #[error(
        "the worker does not answer questions: it is just starting, or its config says `queries.answer = \
         \"off\"`. Ask in this process instead (`joulebus_planner::Planner`, `joulebus ask \
             --through memory`)"
    )]
    NotServed,
    /// The worker has not taken an earlier question that was given up.
    #[error(
        "the worker has not yet taken the previous question, which this client gave up. It is \
         overloaded, or stopped"
    )]
    Full,
    /// No answer before the deadline.
    #[error(
        "no answer within {:.3} s: the worker is busy with other questions, or overloaded",
        *waited_ns as f64 * 1e-9
    )]
    TimedOut { waited_ns: u64 },
    /// Too many values.
    #[error("a question of {found} values: allowed are {allowed}. Ask in this process instead")]
    TooLong { found: usize, allowed: usize },
    /// iceoryx2 refused.
    #[error("cannot ask the worker: {reason}. Join again")]
    Send { reason: String },
    /// Waiting or waking failed.
    #[error(transparent)]
    Wait(#[from] WaitError),
}
