#![doc = include_str!("../README.md")]
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
pub use joulebus_settings::{Domain, DomainError, Limits, LimitsError, STANDBY_FILES, Scheduling};
pub use liveness::peer_watch::PeerWatch;
pub use liveness::presence::FilesRemoved;
pub use liveness::worker_lock::{WorkerLock, WorkerLockError, WorkerOwner};
pub use membership::JoinError;
pub use no_worker::{NoWorker, OtherRoot, fleets_below, other_roots, own_roots};
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
