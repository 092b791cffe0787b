//! `joulebus-bus` in the memory of one simulation: the same names, for the same sources.
//!
//! What decides whose frames are taken (`worker_ports.rs`), is the source of `crates/host/bus`.
//! Ports here are queues; what iceoryx2 does is replaced, and only that.
#![allow(missing_docs)] // Used by tests alone.
#![forbid(unsafe_code)]
#![allow(clippy::missing_errors_doc, reason = "`joulebus-bus` documents them")]

mod background;
mod begin;
mod bus;
pub mod clock;
mod left;
mod liveness;
mod ports;
mod query;
mod queues;
mod wait;

pub use background::{Background, Rounds, Steps, ThreadWatch};
pub use begin::{begin, ports_of, remove_process, size};
pub use bus::{Bus, remove_files};
pub use joulebus_bus::{
    CapacityError, FilesRemoved, IceoryxConfigError, JoinError, OpenError, Panicked, QueryError,
    ReceiveError, RootError, SchedulingError, SendError, Sent, SweepError, ThreadsApart, WaitError,
    Woken, WorkerLockError, schedule_process, schedule_thread,
};
pub use joulebus_settings::{Domain, DomainError, Limits, LimitsError, STANDBY_FILES, Scheduling};
pub use liveness::peer_watch::PeerWatch;
pub use liveness::worker_lock::WorkerLock;
pub use ports::{
    Frame, FrameBuf, IncomingFrame, Loan, Reader, SampleReader, SampleWriter, Taken, Writer,
    WriterWatch, taken_frames,
};
pub use query::{OpenQuery, QueryClient, QueryServer};
pub use wait::{Poller, Readiness, Waiter, Waker};

/// The id of the process that runs.
pub fn process_id() -> u32 {
    joulebus_simulated_host::current()
}

/// Memory needs no touching.
pub const fn touch_own_memory() {}

/// There is one processor, and no nice value.
pub const fn yield_to_the_worker(_nice: u8) {}

pub const fn set_timer_slack() -> std::io::Result<()> {
    Ok(())
}

/// The ports of a start, as in `joulebus-bus`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ports {
    /// Processes that publish samples.
    pub sources: usize,
    pub workers: usize,
    pub planners: usize,
}

/// Checks that shared memory is not full.
pub fn check_capacity(_limits: &Limits, _ports: Ports) -> Result<(), CapacityError> {
    joulebus_simulated_host::operation();
    left::check_left()
}
