//! What clients can take of the server, and the share of each.
//!
//! A client is an address, or a user at the Unix socket ([`Peer`]). What ends by itself is refused
//! to a client that has as much of it as is free: one alone gets half, and something is left for
//! the next. Connections and streams may last. They give way instead ([`super::connections`]).

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};

use super::error::ApiError;
use super::listen::Peer;

/// A limit of the server, of all clients together.
#[derive(Debug)]
pub(super) struct Limit {
    pub(super) what: &'static str,
    pub(super) all: usize,
}

const fn limit(what: &'static str, all: usize) -> Limit {
    Limit { what, all }
}

/// If all are taken, an idle one of the client with most gives way, or else its newest.
pub(super) const CONNECTIONS: Limit = limit("connections", 256);
/// Connections beside these, for supervisors of processes. They give way alike.
pub(super) const RESERVED: Limit = limit("reserved connections", 16);
/// If all are taken, the newest of the client with most gives way.
pub(super) const STREAMS: Limit = limit("streams", 128);
/// Questions about plans that wait, with the one that is computed.
const QUESTIONS: Limit = limit("questions about plans", 16);
/// Statements of persons that wait, with the one that is done.
const STATEMENTS: Limit = limit("statements of persons", 16);
/// Readings of the ledger that wait, with the one that is done. A whole ledger takes time, and no
/// statement waits for it.
const CAPACITIES: Limit = limit("capacities", 16);
/// Requests that wait for the thread that reads the fleet.
pub(super) const READINGS: Limit = limit("requests for values of the fleet", 64);
/// Bodies of requests on their way here.
const RECEIVED: Limit = limit("bytes of requests", 16 << 20);
/// Bodies of answers that their clients have not taken yet.
const UNSENT: Limit = limit("bytes of answers", 64 << 20);

/// All shares of clients.
#[derive(Debug)]
pub(super) struct AllShares {
    pub(super) questions: Queue,
    pub(super) statements: Queue,
    pub(super) capacities: Queue,
    pub(super) readings: Arc<Shares>,
    pub(super) received: Arc<Shares>,
    pub(super) unsent: Arc<Shares>,
}

impl Default for AllShares {
    fn default() -> Self {
        Self {
            questions: Queue::new(&QUESTIONS),
            statements: Queue::new(&STATEMENTS),
            capacities: Queue::new(&CAPACITIES),
            readings: Shares::new(&READINGS),
            received: Shares::new(&RECEIVED),
            unsent: Shares::new(&UNSENT),
        }
    }
}

/// Shares of one limit, by client.
#[derive(Debug)]
pub(super) struct Shares {
    limit: &'static Limit,
    taken: Mutex<HashMap<Peer, usize>>,
}

/// A client's part of a limit, given back when dropped.
#[derive(Debug)]
pub(super) struct Share {
    of: Arc<Shares>,
    peer: Peer,
    amount: usize,
}

impl Shares {
    pub(super) fn new(limit: &'static Limit) -> Arc<Self> {
        Arc::new(Self { limit, taken: Mutex::default() })
    }

    /// Takes `amount` for a client. One that has nothing gets the rest if that is less.
    ///
    /// # Errors
    /// Nothing is left, or the client would have more than is free then.
    pub(super) fn take(self: &Arc<Self>, peer: Peer, amount: usize) -> Result<Share, ApiError> {
        let (mut taken, limit) = (self.lock(), self.limit);
        let free = limit.all - taken.values().sum::<usize>();
        let own = taken.get(&peer).copied().unwrap_or(0);
        let amount = if own == 0 { amount.min(free) } else { amount };
        if free == 0 || (own > 0 && own + amount > free) {
            let Limit { what, all } = limit;
            let text = format!(
                "{what}: {own} are taken by your address or user, and {free} of {all} are free, of \
                 which a client gets as many as it leaves: ask again"
            );
            return Err(ApiError::busy(text));
        }
        *taken.entry(peer).or_default() += amount;
        Ok(Share { of: Arc::clone(self), peer, amount })
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<Peer, usize>> {
        // Nothing panics while the lock is held.
        self.taken.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        let mut taken = self.of.lock();
        if let Some(own) = taken.get_mut(&self.peer) {
            *own -= self.amount;
            if *own == 0 {
                taken.remove(&self.peer);
            }
        }
    }
}

/// Where clients wait for what one does at a time. Of each client one waits in the order of
/// arrival, and its others behind that one.
#[derive(Debug)]
pub(super) struct Queue {
    shares: Arc<Shares>,
    permit: Arc<Semaphore>,
    turns: Mutex<HashMap<Peer, Arc<Semaphore>>>,
}

/// The turn of a client, over when dropped.
#[derive(Debug)]
pub(super) struct Turn {
    _permit: OwnedSemaphorePermit,
    _own: OwnedSemaphorePermit,
    _share: Share,
}

impl Queue {
    fn new(limit: &'static Limit) -> Self {
        let (permit, turns) = (Arc::new(Semaphore::new(1)), Mutex::default());
        Self { shares: Shares::new(limit), permit, turns }
    }

    /// Waits for the client's turn.
    ///
    /// # Errors
    /// The client's share is taken.
    pub(super) async fn enter(&self, peer: Peer) -> Result<Turn, ApiError> {
        let share = self.shares.take(peer, 1)?;
        let own = {
            let mut turns = self.turns.lock().unwrap_or_else(PoisonError::into_inner);
            // Those without a request have left.
            turns.retain(|_, own| Arc::strong_count(own) > 1);
            Arc::clone(turns.entry(peer).or_insert_with(|| Arc::new(Semaphore::new(1))))
        };
        let ending = |_| ApiError::busy("the server is ending");
        let own = own.acquire_owned().await.map_err(ending)?;
        let permit = Arc::clone(&self.permit).acquire_owned().await.map_err(ending)?;
        Ok(Turn { _permit: permit, _own: own, _share: share })
    }
}

/// Takes the answer of another thread. The request counts until it is answered or given up there.
#[derive(Debug)]
pub(super) struct Reply<T> {
    to: oneshot::Sender<T>,
    _share: Share,
}

impl<T> Reply<T> {
    pub(super) fn new(share: Share) -> (Self, oneshot::Receiver<T>) {
        let (to, answer) = oneshot::channel();
        (Self { to, _share: share }, answer)
    }

    /// Answers. A client that has left does not wait for it.
    pub(super) fn send(self, answer: T) {
        drop(self.to.send(answer));
    }

    /// True if its client waits.
    pub(super) fn is_wanted(&self) -> bool {
        !self.to.is_closed()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_every_limit_something_is_left_for_the_next_client_and_all_is_given_back() {
        for limit in [&QUESTIONS, &STATEMENTS, &CAPACITIES, &READINGS, &RECEIVED, &UNSENT] {
            let (shares, what) = (Shares::new(limit), limit.what);
            let part = limit.all.div_ceil(64);
            let all_of = |peer| -> Vec<Share> {
                std::iter::from_fn(|| shares.take(peer, part).ok()).take(1_000).collect()
            };
            let took = |shares: &[Share]| shares.iter().map(|share| share.amount).sum::<usize>();
            let one = all_of(Peer::User(0));
            assert_eq!(took(&one), limit.all / 2, "{what}");
            let refused = shares.take(Peer::User(0), part).unwrap_err();
            assert!(refused.text.starts_with(what), "{refused:?}");
            // A few that take all they get leave something to the next.
            let others = [1, 2, 3].map(|user| all_of(Peer::User(user)));
            assert!(others.iter().all(|other| took(other) > 0), "{what}");
            // One that is longer than what is left is taken, if it is the client's only one.
            assert!(shares.take(Peer::User(9), limit.all).is_ok() || took(&others[2]) == 1);
            drop((one, others));
            assert!(shares.lock().is_empty(), "{what}");
        }
    }

    #[tokio::test]
    async fn a_client_waits_for_one_request_of_each_other() {
        let queue = Queue::new(&QUESTIONS);
        let [one, other] = [Peer::User(0), Peer::User(1)];
        let computed = queue.enter(one).await.unwrap();
        let second = queue.enter(one);
        let third = queue.enter(other);
        tokio::pin!(second, third);
        // Both ask, the greedy one first.
        tokio::select! {
            biased;
            _ = &mut second => panic!("while another is computed"),
            _ = &mut third => panic!("while another is computed"),
            () = async {} => {}
        }
        drop(computed);
        let third = tokio::select! {
            biased;
            _ = &mut second => panic!("before another client"),
            third = &mut third => third.unwrap(),
        };
        tokio::select! {
            biased;
            _ = &mut second => panic!("while another is computed"),
            () = async {} => {}
        }
        drop(third);
        assert!(second.await.is_ok());
        let again = queue.enter(other).await;
        assert!(again.is_ok() && queue.turns.lock().unwrap().len() == 1);
    }
}
