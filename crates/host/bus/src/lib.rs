//! The bus: everything that happens in shared memory, and the only crate that names iceoryx2.
//!
//! Controllers and planners use it through `joulebus-publisher` and `joulebus-consumer`. No type of
//! iceoryx2 is in its API.
//!
//! ```no_run
//! use joulebus_bus::{Bus, Domain};
//!
//! let domain = Domain::new("lab", &Domain::default_root(), "jb_")?;
//! let bus = Bus::join(&domain, "my-program")?;
//! println!("a member of {}", bus.domain().directory().display());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! **Three types to know.** A [`Domain`] is the location of a fleet's shared memory. A [`Bus`] is
//! the membership of a process: it joins with [`Bus::join`], opens the ports it needs, and leaves
//! by dropping them. A [`WorkerLock`] makes a process the fleet's worker. [`Limits`] are the same
//! for every process of a fleet. The first process to open a service creates it.
//!
//! | port | direction | payload |
//! |---|---|---|
//! | [`SampleWriter`] → [`SampleReader`] | sources → worker | [`joulebus_wire::Samples`] |
//! | [`Bus::writer`] → [`Bus::reader`] | worker → planners, recorders | the other channels |
//! | [`QueryClient`] ⇄ [`QueryServer`] | planners ⇄ worker | questions and answers |
//! | [`Waker`] → [`Waiter`] | sources → worker, worker → planners | events |
//!
//! **Threads and processes.** Ports, the [`Bus`] and the [`Waiter`] belong to the thread that made
//! them. A process may join several domains, and may use iceoryx2 for itself: the global
//! configuration and the logger of iceoryx2 are left to it.
//!
//! **Cleanup.** Every member runs a cleanup thread that removes stale files of dead processes
//! ([`Bus::housekeeping`]). The last member to leave removes all files of the domain, in `/dev/shm`
//! and in the root directory. What joulebus did not make, by its marker and names, it neither
//! changes nor removes. A member whose own files are removed gets [`FilesRemoved`] from every port.
//!
//! **Units** are ns of the host's monotonic clock ([`clock`]) and bytes.
//!
//! **Errors** name the obstacle and the remedy: [`JoinError`] and [`OpenError`] at the start,
//! [`SendError`], [`ReceiveError`] and [`WaitError`] later.
//!
//! **In the book**: [files and shared memory][1], [layout of shared memory][2], [joulebus shares
//! iceoryx2][3], [every member cleans up][4], [wait with one ppoll][5].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/reference/files.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/crates/languages/c/include/joulebus.h
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/iceoryx2.md
//! [4]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/shared-memory-processes.md#every-member-cleans-up-and-the-kernel-reports-deaths
//! [5]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/shared-memory-processes.md#wait-with-one-ppoll-not-with-iceoryx2s-waitset
#![deny(unsafe_code)]

mod adopt;
mod bus;
mod cleanup;
mod description;
mod directory;
mod iceoryx_config;
mod iceoryx_log;
mod inspect;
mod ipc;
mod liveness;
mod marker;
mod membership;
mod no_worker;
mod os;
mod ports;
mod preflight;
mod private;
mod reserved;

pub use bus::Bus;
pub use cleanup::removed::{RemovedFiles, removed_files};
pub use cleanup::report::SweepReport;
pub use cleanup::sweep::{SweepError, sweep};
pub use cleanup::thread::Housekeeping;
pub use directory::{prepare_domain, restrict_domain};
pub use iceoryx_config::IceoryxConfigError;
pub use iceoryx_log::trace_iceoryx2;
pub use inspect::{InspectError, Inspection, NodeInfo, RootInfo, inspect, nodes};
pub use joulebus_domain::{Domain, DomainError, Limits, LimitsError, STANDBY_FILES, Scheduling};
pub use liveness::peer_watch::PeerWatch;
pub use liveness::presence::FilesRemoved;
pub use liveness::worker_lock::{WorkerLock, WorkerLockError, WorkerOwner};
pub use membership::JoinError;
pub use no_worker::{NoWorker, OtherRoot, other_roots};
pub use os::apart::ThreadsApart;
pub use os::background::{Background, Panicked, Rounds, Running, Steps, ThreadWatch, make_calls};
pub use os::clock;
pub use os::fork::ForkSection;
pub use os::memory::touch_own_memory;
pub use os::process_id;
pub use os::scheduling::{
    Rights, SchedulingError, page_faults, schedule_process, schedule_thread, set_timer_slack,
    try_scheduling, yield_to_the_worker,
};
pub use ports::{
    Frame, FrameBuf, IncomingFrame, Loan, OpenError, OpenQuery, Poller, QueryClient, QueryError,
    QueryServer, Reader, Readiness, ReceiveError, SampleReader, SampleWriter, SendError, Sent,
    WaitError, Waiter, Waker, Woken, Writer, WriterWatch,
};
pub use preflight::{
    CapacityError, CapacityReport, Ports, check_capacity, check_stack, check_threads,
};
pub use private::{DomainWarning, RootError};
