//! Connection limits: how many connections, how long a transfer may take, and which connection is
//! closed for another.
//!
//! A connection without a request is idle, and so is one whose request's body still arrives. If all
//! slots are taken, the client with most gives one to a client with fewer: the oldest that is idle,
//! or else the newest with a request or stream. Nobody gives one to a client that has more. Beside
//! these there is a reserve, where only `/healthz` and `/readyz` are answered.

use std::cmp::Reverse;
use std::collections::{BTreeMap, HashMap};
use std::io;
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::body::{Body, Bytes, HttpBody};
use hyper::body::{Frame, SizeHint};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::sync::Notify;
use tokio::time::{Instant, Sleep, sleep};

use super::error::ApiError;
use super::listen::Peer;
use super::shares::{CONNECTIONS, Limit, RESERVED, STREAMS, Share};

/// Within `WRITE_TIMEOUT` a client must take this many bytes of the queued ones, or all of them.
/// Otherwise it is disconnected.
const WRITE_BYTES: u64 = 64 << 10;
const WRITE_TIMEOUT: Duration = Duration::from_secs(10);

#[derive(Debug)]
pub(super) struct Connection {
    client: Peer,
    /// Requests being answered, streams included.
    busy: AtomicUsize,
    is_stream: AtomicBool,
    close: Notify,
    /// True if all slots were busy: only requests for the health are answered.
    pub(super) is_reserved: bool,
}

impl Connection {
    fn new(client: Peer, is_reserved: bool) -> Self {
        let (busy, is_stream) = (AtomicUsize::new(0), AtomicBool::new(false));
        Self { client, busy, is_stream, close: Notify::new(), is_reserved }
    }

    /// Waits until the connection has to close.
    pub(super) async fn closed(&self) {
        self.close.notified().await;
    }

    fn is_idle(&self) -> bool {
        self.busy.load(Ordering::Relaxed) == 0
    }

    fn is_stream(&self) -> bool {
        self.is_stream.load(Ordering::Relaxed)
    }
}

/// All connections by a growing number.
#[derive(Debug, Default)]
pub(super) struct Connections {
    open: Mutex<Open>,
}

/// Connections by a growing number, and those in the reserve.
#[derive(Debug, Default)]
struct Open {
    number: u64,
    usual: BTreeMap<u64, Arc<Connection>>,
    reserved: BTreeMap<u64, Arc<Connection>>,
}

/// Makes room for one more of `client` among the connections that count for `limit`. A client that
/// has `ahead` more than it has gives way also where it is not idle. Returns whether there is room.
fn make_room(
    connections: &mut BTreeMap<u64, Arc<Connection>>,
    limit: &Limit,
    client: Peer,
    ahead: usize,
    counts: impl Fn(&Connection) -> bool,
) -> bool {
    let counted: Vec<_> =
        connections.iter().filter(|(_, open)| counts(open)).map(|(n, open)| (*n, open)).collect();
    if counted.len() < limit.all {
        return true;
    }
    let mut of: HashMap<Peer, usize> = HashMap::new();
    for (_, open) in &counted {
        *of.entry(open.client).or_default() += 1;
    }
    let own = of.get(&client).copied().unwrap_or(0);
    let having = |open: &Connection| of[&open.client];
    let idle = counted.iter().filter(|(_, open)| open.is_idle() && having(open) >= own);
    let idle = idle.max_by_key(|(number, open)| (having(open), Reverse(*number)));
    let busy = counted.iter().filter(|(_, open)| having(open) >= own + ahead);
    let busy = || busy.max_by_key(|(number, open)| (having(open), *number));
    let Some(number) = idle.or_else(busy).map(|(number, _)| *number) else {
        return false;
    };
    // The closed connection's own slot is no longer in the map, so its later release does nothing.
    if let Some(connection) = connections.remove(&number) {
        connection.close.notify_one();
    }
    true
}

/// The slot of a connection, released when dropped.
#[derive(Debug)]
pub(super) struct Slot {
    connections: Arc<Connections>,
    number: u64,
    pub(super) connection: Arc<Connection>,
}

impl Connections {
    /// Takes a slot for a connection, from the reserve if clients with no more keep all others busy.
    pub(super) fn enter(self: &Arc<Self>, client: Peer) -> Slot {
        let mut open = self.lock();
        let is_reserved = !make_room(&mut open.usual, &CONNECTIONS, client, 2, |_| true);
        if is_reserved {
            // A client that waits for an answer gets it at once.
            let _ = make_room(&mut open.reserved, &RESERVED, client, 0, |_| true);
        }
        open.number += 1;
        let number = open.number;
        let connection = Arc::new(Connection::new(client, is_reserved));
        let slots = match is_reserved {
            true => &mut open.reserved,
            false => &mut open.usual,
        };
        slots.insert(number, Arc::clone(&connection));
        Slot { connections: Arc::clone(self), number, connection }
    }

    /// Makes a connection one with a stream, until it closes.
    ///
    /// # Errors
    /// All streams are taken, and no client has more than this one would have.
    pub(super) fn begin_stream(&self, connection: &Connection) -> Result<(), ApiError> {
        let (mut open, client) = (self.lock(), connection.client);
        if !make_room(&mut open.usual, &STREAMS, client, 2, Connection::is_stream) {
            let text = format!(
                "{} streams are open, and no client has more than yours: close one, or ask later",
                STREAMS.all
            );
            return Err(ApiError::busy(text));
        }
        connection.is_stream.store(true, Ordering::Relaxed);
        Ok(())
    }

    fn lock(&self) -> MutexGuard<'_, Open> {
        // Nothing panics while the lock is held.
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        let mut open = self.connections.lock();
        open.usual.remove(&self.number);
        open.reserved.remove(&self.number);
    }
}

/// Marks a connection as busy for its lifetime.
#[derive(Debug)]
pub(super) struct Busy(Arc<Connection>);

impl Busy {
    pub(super) fn new(connection: &Arc<Connection>) -> Self {
        connection.busy.fetch_add(1, Ordering::Relaxed);
        Self(Arc::clone(connection))
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        self.0.busy.fetch_sub(1, Ordering::Relaxed);
    }
}

/// A connection whose request's body still arrives: it may be closed for another.
#[derive(Debug)]
pub(super) struct Receiving(Arc<Connection>);

impl Receiving {
    pub(super) fn new(connection: &Arc<Connection>) -> Self {
        connection.busy.fetch_sub(1, Ordering::Relaxed);
        Self(Arc::clone(connection))
    }
}

impl Drop for Receiving {
    fn drop(&mut self) {
        self.0.busy.fetch_add(1, Ordering::Relaxed);
    }
}

/// A response body. Its connection is busy, and its bytes count for the client, until it has been
/// sent or dropped.
#[derive(Debug)]
pub(super) struct Marked {
    body: Body,
    held: Arc<(Busy, Option<Share>)>,
}

impl Marked {
    pub(super) fn new(body: Body, busy: Busy, share: Option<Share>) -> Self {
        Self { body, held: Arc::new((busy, share)) }
    }
}

/// Bytes that wait to be sent.
struct Unsent {
    bytes: Bytes,
    _held: Arc<(Busy, Option<Share>)>,
}

impl AsRef<[u8]> for Unsent {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

impl HttpBody for Marked {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let held = Arc::clone(&self.held);
        let owned = |bytes| Bytes::from_owner(Unsent { bytes, _held: held });
        Pin::new(&mut self.body)
            .poll_frame(cx)
            .map(|frame| frame.map(|frame| frame.map(|frame| frame.map_data(owned))))
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

/// Bytes that a client must take, and the deadline.
#[derive(Debug, Default)]
struct Due {
    /// Bytes that it has taken.
    taken: u64,
    /// Bytes that it must have taken, and when, while some wait.
    by: Option<(u64, Instant)>,
}

impl Due {
    /// Notes that the client took `bytes` of the queued ones.
    fn take(&mut self, bytes: usize) {
        self.taken += bytes as u64;
        if self.by.is_some_and(|(due, _)| self.taken >= due) {
            self.by = None;
        }
    }

    /// Notes that the client takes nothing although `bytes` are queued. Returns the deadline.
    fn wait(&mut self, bytes: usize, now: Instant) -> Instant {
        let due = self.taken + WRITE_BYTES.min(bytes as u64);
        let (_, until) = *self.by.get_or_insert((due, now + WRITE_TIMEOUT));
        until
    }
}

/// A stream whose writes fail if the client takes too little within [`WRITE_TIMEOUT`].
#[derive(Debug)]
pub(super) struct Watched<S> {
    stream: S,
    due: Due,
    /// Wakes a write that waits, at the time that is due.
    timer: Pin<Box<Sleep>>,
}

impl<S> Watched<S> {
    pub(super) fn new(stream: S) -> Self {
        Self { stream, due: Due::default(), timer: Box::pin(sleep(WRITE_TIMEOUT)) }
    }

    /// The result of writing some of `bytes`, or an error if the client takes too little.
    fn watch(
        &mut self,
        cx: &mut Context<'_>,
        bytes: usize,
        written: Poll<io::Result<usize>>,
    ) -> Poll<io::Result<usize>> {
        if let Poll::Ready(result) = written {
            self.due.take(*result.as_ref().unwrap_or(&0));
            return Poll::Ready(result);
        }
        let until = self.due.wait(bytes, Instant::now());
        if self.timer.deadline() != until {
            self.timer.as_mut().reset(until);
        }
        match self.timer.as_mut().poll(cx) {
            Poll::Ready(()) => Poll::Ready(Err(io::ErrorKind::TimedOut.into())),
            Poll::Pending => Poll::Pending,
        }
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Watched<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(cx, buffer)
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Watched<S> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(cx, bytes);
        self.watch(cx, bytes.len(), written)
    }

    // Without it hyper copies each answer into a buffer of its own, which nobody counts.
    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        parts: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(cx, parts);
        let bytes = parts.iter().map(|part| part.len()).sum();
        self.watch(cx, bytes, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_idle_connection_gives_way_and_busy_ones_leave_the_reserve() {
        let connections = Arc::new(Connections::default());
        let enter = || connections.enter(Peer::User(0));
        let mut slots: Vec<Slot> = (0..CONNECTIONS.all).map(|_| enter()).collect();
        let busy = slots.iter().skip(2);
        let mut busy: Vec<Busy> = busy.map(|slot| Busy::new(&slot.connection)).collect();
        let (first, second) = (enter(), enter());
        let is_open = |slot: &Slot| connections.lock().usual.contains_key(&slot.number);
        assert!(!is_open(&slots[0]) && !is_open(&slots[1]));
        assert!([&first, &second].map(is_open) == [true; 2]);
        busy.extend([&first, &second].map(|slot| Busy::new(&slot.connection)));
        // All are busy: what comes now is for the health alone, and never keeps the next out. Who
        // has not asked gives way first.
        let asked = enter();
        let asking = Busy::new(&asked.connection);
        let last: Vec<Slot> = (0..3 * RESERVED.all).map(|_| enter()).collect();
        assert!(last.iter().all(|slot| slot.connection.is_reserved));
        let reserved = |slot: &Slot| connections.lock().reserved.contains_key(&slot.number);
        assert!(reserved(&asked) && reserved(&last[last.len() - 1]) && !reserved(&last[0]));
        assert_eq!(connections.lock().reserved.len(), RESERVED.all);
        drop((asking, asked));
        // A body that drips keeps nobody out.
        let dripping = Receiving::new(&slots[7].connection);
        let usual = enter();
        assert!(!usual.connection.is_reserved && !is_open(&slots[7]));
        drop(dripping);
        // Another client takes the place of the newest, and keeps it while it has fewer.
        busy.push(Busy::new(&usual.connection));
        let other = connections.enter(Peer::User(1));
        busy.push(Busy::new(&other.connection));
        assert!(!other.connection.is_reserved && !is_open(&usual));
        let more: Vec<Slot> = (0..50).map(|_| enter()).collect();
        assert!(is_open(&other) && more.iter().all(|slot| slot.connection.is_reserved));
        // Until the two have the same.
        let others: Vec<Slot> = (1..200)
            .map(|_| {
                let slot = connections.enter(Peer::User(1));
                busy.push(Busy::new(&slot.connection));
                slot
            })
            .collect();
        let opened = others.iter().filter(|slot| is_open(slot)).count();
        assert_eq!(opened, CONNECTIONS.all / 2 - 1);
        drop((busy, last, more, other, others));
        // Dropping a closed connection releases no other connection's slot.
        let left = connections.lock().usual.len();
        slots.clear();
        assert!(left > connections.lock().usual.len());
        drop((first, second, usual));
        assert_eq!(connections.lock().usual.len(), 0);
    }

    #[test]
    fn the_client_with_most_streams_gives_one_to_a_client_with_fewer() {
        let connections = Arc::new(Connections::default());
        let stream = |user| {
            let slot = connections.enter(Peer::User(user));
            let busy = Busy::new(&slot.connection);
            connections.begin_stream(&slot.connection).ok().map(|()| (slot, busy))
        };
        let all: Vec<_> = (0..STREAMS.all + 9).filter_map(|_| stream(0)).collect();
        assert_eq!(all.len(), STREAMS.all);
        let others = 0..2 * STREAMS.all as u32;
        let others: Vec<_> = others.filter_map(|number| stream(1 + number % 3)).collect();
        let open = connections.lock();
        let of = |user| {
            let own = |open: &&Arc<Connection>| open.client == Peer::User(user) && open.is_stream();
            open.usual.values().filter(own).count()
        };
        assert_eq!([0, 1, 2, 3].map(of), [STREAMS.all / 4; 4]);
        drop(open);
        drop((all, others));
    }

    #[test]
    fn a_client_must_take_what_waits_or_64_kib_of_it_in_ten_seconds() {
        let begin = Instant::now();
        let at = |seconds| begin + Duration::from_secs(seconds);
        let mut due = Due::default();
        assert_eq!(due.wait(1_000, at(0)), at(10));
        // A byte now and then does not prolong it.
        for second in 1..10 {
            due.take(1);
            assert_eq!(due.wait(1_000, at(second)), at(10));
        }
        // This covers the bytes queued first. Later ones have a deadline of their own.
        due.take(991);
        assert_eq!(due.wait(9, at(9)), at(19));
        due.take(9);
        assert_eq!(due.wait(1 << 20, at(30)), at(40));
        // A slow one that takes 64 KiB of much that waits.
        due.take(64 << 10);
        assert_eq!(due.wait(15 << 16, at(38)), at(48));
    }
}
