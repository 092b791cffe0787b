//! The network as one simulated host has it: messages to send lie here until the simulation takes
//! them, and arrive when it delivers them.

use std::borrow::Cow;
use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

use joulebus_simulated_host::{self as host, memory::outside, time};

use crate::protocol::carried::Kind;

/// The limit of the real inbox.
const MAX_QUEUED: usize = 256;
const MAX_QUEUED_LONGEST: usize = 4;

/// A stream's kind, and whether it has the requests.
type Stream = (Kind, bool);

/// A message from link to link.
#[derive(Debug, Clone)]
pub struct Packet {
    pub from: String,
    /// The link that it is meant for.
    pub to: String,
    stream: Stream,
    pub bytes: Vec<u8>,
}

#[derive(Debug)]
struct Subscription {
    stream: Stream,
    /// Without it those of all links.
    from: Option<String>,
    queue: Rc<Queue>,
}

#[derive(Debug)]
struct Queue {
    pid: u32,
    thread: u64,
    max_bytes: usize,
    events: RefCell<VecDeque<Event>>,
    waiting_bytes: Cell<usize>,
    overflowed: Cell<u64>,
}

thread_local! {
    static SENT: RefCell<Vec<Packet>> = const { RefCell::new(Vec::new()) };
    static SUBSCRIPTIONS: RefCell<Vec<Subscription>> = const { RefCell::new(Vec::new()) };
}

/// The messages that links of this host have sent since the last call.
pub fn take_sent() -> Vec<Packet> {
    SENT.take()
}

/// A message arrives on this host.
pub fn deliver(packet: &Packet) {
    let from: Arc<str> = packet.from.as_str().into();
    let arrived_ns = time::monotonic_ns();
    put(
        |subscription| subscription.stream == packet.stream && subscription.is_from(&from),
        || Event::Message {
            from: Arc::clone(&from),
            bytes: Bytes(packet.bytes.clone()),
            arrived_ns,
        },
    );
}

/// The connection to the link `name` is lost.
pub fn lose(name: &str) {
    let name: Arc<str> = name.into();
    put(|subscription| subscription.is_from(&name), || Event::Lost { name: Arc::clone(&name) });
}

fn put(is_meant: impl Fn(&Subscription) -> bool, event: impl Fn() -> Event) {
    SUBSCRIPTIONS.with_borrow(|all| {
        for subscription in all.iter().filter(|subscription| is_meant(subscription)) {
            subscription.queue.put(event());
            host::wake(subscription.queue.pid, subscription.queue.thread);
        }
    });
}

impl Subscription {
    fn is_from(&self, name: &str) -> bool {
        self.from.as_deref().is_none_or(|from| from == name)
    }
}

impl Queue {
    fn put(&self, event: Event) {
        let bytes = self.waiting_bytes.get() + event.bytes();
        let mut events = self.events.borrow_mut();
        if bytes > self.max_bytes || events.len() == MAX_QUEUED {
            self.overflowed.set(self.overflowed.get() + 1);
        } else {
            self.waiting_bytes.set(bytes);
            outside(|| events.push_back(event));
        }
    }
}

/// An event of the network, as the real one has them.
#[derive(Debug)]
pub(crate) enum Event {
    Message { from: Arc<str>, bytes: Bytes, arrived_ns: u64 },
    Lost { name: Arc<str> },
}

impl Event {
    const fn bytes(&self) -> usize {
        match self {
            Self::Message { bytes, .. } => bytes.0.len(),
            Self::Lost { .. } => 0,
        }
    }
}

#[derive(Debug)]
pub(crate) struct Bytes(Vec<u8>);

impl Bytes {
    pub(crate) fn get(&self) -> Cow<'_, [u8]> {
        Cow::Borrowed(&self.0)
    }
}

#[derive(Debug)]
pub(crate) struct Inbox(Rc<Queue>);

impl Inbox {
    pub(crate) fn new(max_message_bytes: usize) -> Self {
        Self(Rc::new(Queue {
            pid: host::current(),
            thread: host::thread(),
            max_bytes: max_message_bytes.saturating_mul(MAX_QUEUED_LONGEST),
            events: RefCell::default(),
            waiting_bytes: Cell::default(),
            overflowed: Cell::default(),
        }))
    }

    /// Returns the next event. If there is none, the thread sleeps from its next pause on for
    /// `wait`.
    pub(crate) fn next(&self, wait: Duration) -> Result<Event, RecvTimeoutError> {
        host::operation();
        if let Some(event) = self.0.events.borrow_mut().pop_front() {
            self.0.waiting_bytes.set(self.0.waiting_bytes.get() - event.bytes());
            return Ok(event);
        }
        if !wait.is_zero() {
            host::sleep_until(time::monotonic_ns() + wait.as_nanos() as u64);
        }
        Err(RecvTimeoutError::Timeout)
    }

    /// Links of the simulation have no certificates.
    #[allow(clippy::unnecessary_wraps, clippy::unused_self, reason = "as in the real inbox")]
    pub(crate) fn verify(&self, _: &Arc<str>, _: &Bytes, _: u64) -> anyhow::Result<bool> {
        Ok(true)
    }

    pub(crate) fn overflowed(&self) -> u64 {
        self.0.overflowed.get()
    }
}

impl Drop for Inbox {
    fn drop(&mut self) {
        SUBSCRIPTIONS.with_borrow_mut(|all| {
            all.retain(|subscription| !Rc::ptr_eq(&subscription.queue, &self.0));
        });
    }
}

#[derive(Debug)]
pub(crate) struct Outlet {
    from: String,
    to: String,
    stream: Stream,
}

impl Outlet {
    pub(crate) fn send(&self, bytes: Vec<u8>) {
        host::operation();
        if !host::is_dead() {
            let Self { from, to, stream } = self;
            let (from, to, stream) = (from.clone(), to.clone(), *stream);
            outside(|| SENT.with_borrow_mut(|sent| sent.push(Packet { from, to, stream, bytes })));
        }
    }
}

#[derive(Debug)]
pub(crate) struct Network {
    name: String,
}

/// Nothing is refused here.
#[derive(Debug, thiserror::Error)]
#[error("the network is refused")]
pub(crate) struct NetworkError;

#[allow(clippy::unnecessary_wraps, reason = "as in the real network")]
impl Network {
    pub(crate) fn new(name: &str) -> Self {
        Self { name: name.to_owned() }
    }

    pub(crate) fn frames_to(&self, kind: Kind, to: &str) -> Result<Outlet, NetworkError> {
        Ok(self.outlet((kind, false), to))
    }

    pub(crate) fn requests_to(&self, kind: Kind, from: &str) -> Result<Outlet, NetworkError> {
        Ok(self.outlet((kind, true), from))
    }

    pub(crate) fn take_frames(
        &self,
        kind: Kind,
        from: &str,
        inbox: &mut Inbox,
    ) -> Result<(), NetworkError> {
        let _ = self;
        subscribe((kind, false), Some(from.to_owned()), inbox);
        Ok(())
    }

    pub(crate) fn take_requests(&self, kind: Kind, inbox: &mut Inbox) -> Result<(), NetworkError> {
        let _ = self;
        subscribe((kind, true), None, inbox);
        Ok(())
    }

    fn outlet(&self, stream: Stream, to: &str) -> Outlet {
        Outlet { from: self.name.clone(), to: to.to_owned(), stream }
    }
}

fn subscribe(stream: Stream, from: Option<String>, inbox: &Inbox) {
    host::operation();
    let queue = Rc::clone(&inbox.0);
    outside(|| {
        SUBSCRIPTIONS.with_borrow_mut(|all| all.push(Subscription { stream, from, queue }));
    });
}
