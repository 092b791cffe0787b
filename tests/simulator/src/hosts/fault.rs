//! Faults of hosts.

use simulated_host::disk;
use simulated_link::Access;

pub(super) const MS: u64 = 1_000_000;
pub(super) const SECOND: u64 = 1_000 * MS;
/// Hosts with a worker.
pub(super) const BASES: [&str; 2] = ["base-1", "base-2"];

/// A kind of process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Part {
    Worker,
    Source,
    Planner,
    Link,
}

/// A fault of a host.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Fault {
    /// A process dies in its n-th operation from then.
    Kill(Part, u64),
    /// A process dies in its n-th access to the disk from then.
    KillAtDisk(Part, u64),
    /// A process is asked to end.
    End(Part),
    /// A process is stopped, for a time.
    Pause(Part, u64),
    /// The host is suspended, for a time.
    Suspend(u64),
    /// The host stands still, for a time that its clocks leave out by a jump.
    Jump(u64),
    /// The host, a virtual machine, is paused for a time, and its clocks stand still.
    StandStill(u64),
    /// The wall clock is set, forward or back.
    WallClock(i64),
    /// The monotonic clock is adjusted by so many millionths.
    Drift(i64),
    /// The disk fails, for a time.
    Disk(disk::Fault, u64),
    /// Shared memory is full, for a time.
    MemoryFull(u64),
    /// The power fails, and the host starts again after a time.
    PowerLoss(u64),
    /// This host and another do not reach each other, for a time.
    Cut(usize, u64),
    /// The store behaves so towards this host, for a time.
    Store(Access, u64),
    /// Messages of all hosts are lost and repeated (per mille), and take up to so long, for a time.
    Weather([usize; 2], u64, u64),
}
