//! Connection limits: how many connections, how long a transfer may take, and which connection is
//! closed for another.
//!
//! A connection without a request is idle, and so is one whose request's body still arrives. If all
//! slots are taken, the oldest connection that is idle is closed for the new one. Idle
//! connections therefore keep nobody out, and only streams and requests in progress keep their
//! slots. Beside these there is a reserve, where only `/healthz` and `/readyz` are answered.

use std::collections::BTreeMap;
use std::io;
use std::pin::Pin;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::body::{Body, Bytes, HttpBody};
use hyper::body::{Frame, SizeHint};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::sync::Notify;
use tokio::time::{Instant, Sleep, sleep};

/// Maximum number of connections of clients.
pub(super) const MAX_CONNECTIONS: usize = 256;
/// Connections beside these, for supervisors of processes.
const RESERVED: usize = 16;
/// Within `WRITE_TIMEOUT` a client must take this many bytes of the queued ones, or all of them.
/// Otherwise it is disconnected.
const WRITE_BYTES: u64 = 64 << 10;
const WRITE_TIMEOUT: Duration = Duration::from_secs(10);

#[derive(Debug, Default)]
pub(super) struct Connection {
    /// Requests being answered, streams included.
    busy: AtomicUsize,
    close: Notify,
    /// True if all slots were busy: only requests for the health are answered.
    pub(super) is_reserved: bool,
}

impl Connection {
    /// Waits until the connection has to close.
    pub(super) async fn closed(&self) {
        self.close.notified().await;
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

/// Closes the oldest of those that may be closed, if all `slots` are taken. Returns whether there
/// is a slot then.
fn make_room(
    connections: &mut BTreeMap<u64, Arc<Connection>>,
    slots: usize,
    may_close: impl Fn(&Connection) -> bool,
) -> bool {
    if connections.len() < slots {
        return true;
    }
    let mut open = connections.iter();
    let oldest = open.find(|(_, connection)| may_close(connection));
    let Some(number) = oldest.map(|(number, _)| *number) else {
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
    /// Takes a slot for a connection, from the reserve if requests in progress take all others.
    pub(super) fn enter(self: &Arc<Self>) -> Slot {
        let mut open = self.lock();
        let is_idle = |connection: &Connection| connection.busy.load(Ordering::Relaxed) == 0;
        let is_reserved = !make_room(&mut open.usual, MAX_CONNECTIONS, is_idle);
        if is_reserved {
            // Clients that have not asked go first. A client that waits for an answer gets it at
            // once.
            let _ = make_room(&mut open.reserved, RESERVED, is_idle)
                || make_room(&mut open.reserved, RESERVED, |_| true);
        }
        open.number += 1;
        let number = open.number;
        let connection = Arc::new(Connection { is_reserved, ..Connection::default() });
        let slots = match is_reserved {
            true => &mut open.reserved,
            false => &mut open.usual,
        };
        slots.insert(number, Arc::clone(&connection));
        Slot { connections: Arc::clone(self), number, connection }
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

/// A response body. Its connection is busy until the body has been sent or dropped.
#[derive(Debug)]
pub(super) struct Marked {
    body: Body,
    _busy: Busy,
}

impl Marked {
    pub(super) const fn new(body: Body, busy: Busy) -> Self {
        Self { body, _busy: busy }
    }
}

impl HttpBody for Marked {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.body).poll_frame(cx)
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
        let enter = || connections.enter();
        let mut slots: Vec<Slot> = (0..MAX_CONNECTIONS).map(|_| enter()).collect();
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
        let last: Vec<Slot> = (0..3 * RESERVED).map(|_| enter()).collect();
        assert!(last.iter().all(|slot| slot.connection.is_reserved));
        let reserved = |slot: &Slot| connections.lock().reserved.contains_key(&slot.number);
        assert!(reserved(&asked) && reserved(&last[last.len() - 1]) && !reserved(&last[0]));
        assert_eq!(connections.lock().reserved.len(), RESERVED);
        drop((asking, asked));
        // A body that drips keeps nobody out.
        let dripping = Receiving::new(&slots[7].connection);
        let usual = enter();
        assert!(!usual.connection.is_reserved && !is_open(&slots[7]));
        drop(dripping);
        drop((busy, last));
        // Dropping a closed connection releases no other connection's slot.
        slots.clear();
        assert_eq!(connections.lock().usual.len(), 3);
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
