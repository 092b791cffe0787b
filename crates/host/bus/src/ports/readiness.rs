//! One descriptor for a waiter's events and the end of a watched process, for event loops.

use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd, RawFd};
use std::sync::Arc;

use rustix::event::epoll;

use super::wait::Waiter;
use crate::PeerWatch;

/// A descriptor that is readable when events wait or a watched process is gone: an `epoll` of both,
/// which can itself be polled. It belongs to any thread, and reports nothing after its waiter and
/// watches are gone, also if a child made by `fork` has copies of their descriptors.
#[derive(Debug, Clone)]
pub struct Readiness {
    epoll: Arc<OwnedFd>,
}

impl Readiness {
    /// A descriptor that watches nothing yet.
    ///
    /// # Errors
    /// The operating system's.
    pub fn new() -> io::Result<Self> {
        let epoll = epoll::create(epoll::CreateFlags::CLOEXEC)?;
        Ok(Self { epoll: Arc::new(epoll) })
    }

    /// A descriptor that watches a waiter's events.
    ///
    /// # Errors
    /// The operating system's.
    pub fn of(waiter: &Waiter) -> io::Result<Self> {
        let readiness = Self::new()?;
        waiter.watchers.add(&readiness.epoll, waiter.as_fd())?;
        Ok(readiness)
    }

    /// Watches a process as well, for as long as `peer` lives.
    ///
    /// # Errors
    /// The operating system's.
    pub fn watch(&self, peer: &PeerWatch) -> io::Result<()> {
        peer.watchers.add(&self.epoll, peer.as_fd())
    }
}

impl AsFd for Readiness {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.epoll.as_fd()
    }
}

impl AsRawFd for Readiness {
    fn as_raw_fd(&self) -> RawFd {
        self.epoll.as_raw_fd()
    }
}
