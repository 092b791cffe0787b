//! Waiting without events, for readers that look at fixed times. A listener would cost the worker a
//! system call per tick, and the processor a wake-up.

use std::path::PathBuf;
use std::rc::Rc;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;

use super::wait::{MAX_SLEEP_NS, WaitError, Woken};
use crate::liveness::lock_watch::LockWatch;
use crate::membership::Membership;
use crate::{Bus, PeerWatch, clock};

/// Waits for a time, and for the end of the worker.
#[derive(Debug)]
pub struct Poller {
    lock_file: PathBuf,
    lock: Option<LockWatch>,
    member: Rc<Membership>,
}

impl Poller {
    pub(super) fn new(bus: &Bus) -> Self {
        Self { lock_file: bus.domain().worker_file(), lock: None, member: Rc::clone(&bus.member) }
    }

    /// From now on, process `pid` is the worker whose end is waited for.
    pub fn watch_worker(&mut self, pid: u32) {
        self.lock = LockWatch::open(&self.lock_file, pid);
    }

    /// Sleeps until `deadline_ns` (monotonic), until `peer`, the process of the watched worker, is
    /// gone, or until a signal arrives. At most 100 ms. A shutdown of the worker, and without
    /// `peer` its death, is found when the sleep is over. [`Woken::frame`] is never set. Does not
    /// allocate.
    ///
    /// # Errors
    /// [`WaitError::Removed`] if this process must end, [`WaitError::Poll`] if `poll` fails.
    pub fn wait_until(
        &mut self,
        deadline_ns: u64,
        peer: Option<&PeerWatch>,
    ) -> Result<Woken, WaitError> {
        self.member.presence.check()?;
        let sleep_ns = deadline_ns.saturating_sub(clock::monotonic_ns());
        let timeout =
            Timespec { tv_sec: 0, tv_nsec: sleep_ns.min(MAX_SLEEP_NS).cast_signed() as _ };
        let mut polled = peer.map(|peer| [PollFd::new(peer, PollFlags::IN)]);
        let polled: &mut [PollFd<'_>] = polled.as_mut().map_or(&mut [], |polled| polled);
        let interrupted = match poll(polled, Some(&timeout)) {
            Ok(_) => false,
            Err(Errno::INTR) => true,
            Err(error) => return Err(WaitError::Poll(error.into())),
        };
        let ended = self.lock.as_ref().is_some_and(LockWatch::has_ended);
        let is_left = || self.lock.as_ref().is_some_and(LockWatch::is_left);
        let woken = Woken {
            ended,
            peer_gone: polled.first().is_some_and(|peer| !peer.revents().is_empty()),
            died: peer.is_none() && !ended && is_left(),
            interrupted,
            ..Woken::default()
        };
        if woken.ended || woken.died {
            self.lock = None;
        }
        Ok(woken)
    }
}
