//! Watching one process.

use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, PidfdFlags, pidfd_open};

/// Watches a process for its end.
#[derive(Debug)]
pub struct PeerWatch {
    descriptor: OwnedFd,
}

impl PeerWatch {
    /// Watches the process `pid`. `None` when there is no such process, or when the system cannot
    /// watch (Linux before 5.3, some sandboxes).
    ///
    /// A pid may have been given to another process already: read it again from a fresh frame
    /// after opening.
    #[must_use]
    pub fn open(pid: u32) -> Option<Self> {
        let pid = Pid::from_raw(i32::try_from(pid).ok()?)?;
        let descriptor = pidfd_open(pid, PidfdFlags::empty()).ok()?;
        Some(Self { descriptor })
    }

    /// Whether the process has ended, its parent having waited for it or not.
    #[must_use]
    pub fn is_gone(&self) -> bool {
        let mut polled = [PollFd::new(&self.descriptor, PollFlags::IN)];
        let now = Timespec {
            tv_sec: 0,
            tv_nsec: 0,
        };
        matches!(poll(&mut polled, Some(&now)), Ok(ready) if ready > 0)
    }
}

impl AsFd for PeerWatch {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.descriptor.as_fd()
    }
}
