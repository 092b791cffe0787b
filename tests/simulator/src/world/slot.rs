//! A place for a process.

use std::collections::VecDeque;

use simulated_host as host;

use crate::process::{FrameId, Program};
use crate::scenario::Role;

/// A place for a process.
pub(super) struct Slot {
    /// None: a visitor, which is not restarted.
    pub(super) role: Option<Role>,
    pub(super) name: String,
    pub(super) robots: Vec<u32>,
    pub(super) program: Option<Program>,
    pub(super) pid: u32,
    /// Pid of the process before.
    pub(super) last_pid: u32,
    pub(super) wake_ns: u64,
    /// When it is started again, if it does not run.
    pub(super) start_ns: u64,
    pub(super) paused_until_ns: u64,
    pub(super) cost_ns: u64,
    pub(super) slow_until_ns: u64,
    pub(super) blind_until_ns: u64,
    /// When a visitor leaves.
    pub(super) until_ns: u64,
    /// Accesses to the disk after which it dies, of its next lives.
    pub(super) kills_at_disk: VecDeque<u64>,
    /// False frames that are the first that the next process reads.
    pub(super) greeting: u64,
    /// The power fails for so long when it dies.
    pub(super) power_loss_ns: u64,
    /// Memory when it began its work, bytes.
    pub(super) opened_bytes: i64,
    /// A planner: the worker whose frames it has, and the deadline of learning of its end.
    pub(super) follows: Option<(u32, u64, u64)>,
    pub(super) learn_until_ns: u64,
    /// A planner: the run of the worker, if it was running when the planner had its first frame.
    pub(super) watched: Option<u64>,
    /// A display or a bridge: the frame that it has shown last, its frames, and those it missed.
    pub(super) shown: Option<(FrameId, u64, u64)>,
    /// When it looked last, simulated ns.
    pub(super) looked_ns: u64,
    /// A display or a bridge: until then it may miss frames.
    pub(super) late_until_ns: u64,
    /// A planner: it was warned not to rely on the newest frame.
    pub(super) is_warned: bool,
    /// Reason that it did not start, or ended, the last time.
    pub(super) last: String,
}

impl Slot {
    /// Without a process until `start_ns`.
    pub(super) fn new(role: Option<Role>, name: String, robots: Vec<u32>, start_ns: u64) -> Self {
        Self {
            role,
            name,
            robots,
            program: None,
            pid: 0,
            last_pid: 0,
            wake_ns: u64::MAX,
            start_ns,
            paused_until_ns: 0,
            cost_ns: host::USUAL_COST_NS,
            slow_until_ns: 0,
            blind_until_ns: 0,
            until_ns: u64::MAX,
            kills_at_disk: VecDeque::new(),
            greeting: 0,
            power_loss_ns: 0,
            opened_bytes: 0,
            follows: None,
            learn_until_ns: u64::MAX,
            watched: None,
            shown: None,
            looked_ns: 0,
            late_until_ns: 0,
            is_warned: false,
            last: String::new(),
        }
    }

    /// The process that runs dies in its next access to the disk for which that was asked.
    pub(super) fn is_killed_at_disk(&mut self) {
        if self.pid != 0
            && let Some(accesses) = self.kills_at_disk.pop_front()
        {
            host::kill_at_disk(self.pid, accesses);
        }
    }
}
