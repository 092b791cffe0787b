//! `joulebus-bus` in the memory of one simulation: the same names, for the same sources.
//!
//! What decides whose frames are taken (`worker_ports.rs`), and the sizes of the services (`limits.rs`), are
//! the sources of `crates/bus`. Ports here are queues; what iceoryx2 does is replaced, and only that.
#![forbid(unsafe_code)]

mod background;
mod bus;
#[expect(dead_code, reason = "memory and descriptors are not counted here")]
#[path = "../../../crates/bus/src/limits.rs"]
mod limits;
mod liveness;
mod ports;
mod query;
mod queues;
mod wait;

pub use background::{Background, Steps};
pub use bus::{Bus, Domain, remove_files};
pub use joulebus_bus::{
    CapacityError, DomainError, FilesRemoved, IceoryxConfigError, JoinError, OpenError, Panicked,
    QueryError, ReceiveError, RootError, STANDBY_FILES, Scheduling, SchedulingError, SendError,
    SweepError, WaitError, Woken, WorkerLockError,
};
pub use limits::{Limits, LimitsError};
pub use liveness::peer_watch::PeerWatch;
pub use liveness::worker_lock::WorkerLock;
pub use ports::{
    BudgetReader, BudgetWriter, DiagnosticReader, DiagnosticWriter, ForecastReader, ForecastWriter,
    Frame, IncomingFrame, KeptFrame, Loan, PlanStateReader, PlanStateWriter, QueriesReader,
    QueriesWriter, Reader, SampleReader, SampleTap, SampleWriter, StateReader, StateWriter, Taken,
    TickReader, TickWriter, Writer, taken_frames,
};
pub use query::{OpenQuery, QueryClient, QueryServer};
pub use queues::{begin, remove_process, size};
pub use wait::{Poller, Waiter, Waker};

/// The clocks of the simulated host.
pub mod clock {
    use joulebus_simulated_host::{operation, time};

    /// Time of the monotonic clock, ns.
    #[must_use]
    pub fn monotonic_ns() -> u64 {
        operation();
        time::monotonic_ns()
    }

    /// The same, since no simulated host is suspended; not an operation, so that what workers with a permit need changes nothing for
    /// those without.
    #[must_use]
    pub fn boot_ns() -> u64 {
        time::monotonic_ns()
    }

    /// Wall-clock time, Unix ns.
    #[must_use]
    pub fn unix_ns() -> u64 {
        operation();
        time::unix_ns()
    }

    /// Processor time: all time is.
    #[must_use]
    pub fn thread_cpu_ns() -> u64 {
        monotonic_ns()
    }

    /// The id of this boot.
    ///
    /// # Errors
    /// None.
    pub fn boot_id() -> std::io::Result<String> {
        Ok(format!("boot-{}", time::boots()))
    }
}

/// The id of the process that runs.
#[must_use]
pub fn process_id() -> u32 {
    joulebus_simulated_host::current()
}

/// Memory needs no touching.
pub const fn touch_own_memory() {}

/// There is one processor, and no nice value.
pub const fn yield_to_the_worker(_nice: u8) {}

/// Timers are exact.
///
/// # Errors
/// None.
pub const fn set_timer_slack() -> std::io::Result<()> {
    Ok(())
}

/// The ports of a start, as in `joulebus-bus`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ports {
    /// Processes that publish samples.
    pub sources: usize,
    /// Workers.
    pub workers: usize,
    /// Planners.
    pub planners: usize,
}

/// Checks that shared memory is not full.
///
/// # Errors
/// It is.
pub fn check_capacity(_limits: &Limits, _ports: Ports) -> Result<(), CapacityError> {
    joulebus_simulated_host::operation();
    bus::check_left()
}
