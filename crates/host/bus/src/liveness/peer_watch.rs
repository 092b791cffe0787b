//! Watches one process.

use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, PidfdFlags, pidfd_open};

use crate::os::watchers::Watchers;

/// Detects the end of a process.
#[derive(Debug)]
pub struct PeerWatch {
    descriptor: OwnedFd,
    pub(crate) watchers: Watchers,
}

impl PeerWatch {
    /// Watches the process `pid`. `None` if there is no such process, or if the system cannot watch
    /// processes (Linux before 5.3, some sandboxes).
    ///
    /// The pid may already have been reused: read it again from a new frame after opening.
    #[must_use]
    pub fn open(pid: u32) -> Option<Self> {
        let pid = Pid::from_raw(i32::try_from(pid).ok()?)?;
        let descriptor = pidfd_open(pid, PidfdFlags::empty()).ok()?;
        Some(Self { descriptor, watchers: Watchers::default() })
    }

    /// True if the process has ended, even if its parent has not waited for it.
    pub fn is_gone(&self) -> bool {
        let mut polled = [PollFd::new(&self.descriptor, PollFlags::IN)];
        let now = Timespec { tv_sec: 0, tv_nsec: 0 };
        matches!(poll(&mut polled, Some(&now)), Ok(ready) if ready > 0)
    }
}

impl AsFd for PeerWatch {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.descriptor.as_fd()
    }
}

impl Drop for PeerWatch {
    fn drop(&mut self) {
        self.watchers.remove(self.as_fd());
    }
}
