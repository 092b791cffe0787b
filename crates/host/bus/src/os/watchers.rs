//! The `epoll`s that watch a descriptor.

use std::io;
use std::os::fd::{BorrowedFd, OwnedFd};
use std::process;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use rustix::event::epoll;

/// The `epoll`s that watch a descriptor, which must be [removed](Self::remove) before it is closed.
///
/// Closing alone removes it only if no other process has a copy. A child made by `fork` has one,
/// and then the `epoll` reports a descriptor for ever that nobody can read or remove any more.
#[derive(Debug, Default)]
pub(crate) struct Watchers {
    /// Each with the process that watches: a child shares the `epoll` with its parent.
    epolls: Mutex<Vec<(u32, Weak<OwnedFd>)>>,
}

impl Watchers {
    /// From now on `epoll` is readable when `descriptor` is.
    pub(crate) fn add(&self, epoll: &Arc<OwnedFd>, descriptor: BorrowedFd<'_>) -> io::Result<()> {
        let data = epoll::EventData::new_u64(0);
        epoll::add(epoll, descriptor, data, epoll::EventFlags::IN)?;
        self.epolls().push((process::id(), Arc::downgrade(epoll)));
        Ok(())
    }

    /// To be called before `descriptor` is closed.
    pub(crate) fn remove(&self, descriptor: BorrowedFd<'_>) {
        for (pid, epoll) in self.epolls().drain(..) {
            if pid == process::id()
                && let Some(epoll) = epoll.upgrade()
            {
                // It was added.
                let _ = epoll::delete(&epoll, descriptor);
            }
        }
    }

    fn epolls(&self) -> MutexGuard<'_, Vec<(u32, Weak<OwnedFd>)>> {
        self.epolls.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
