//! The bus: everything that happens in shared memory, and the only crate that names iceoryx2.
//!
//! A [`Domain`] is the location of a fleet's shared memory. A process joins it with [`Bus::join`],
//! opens the ports it needs, and leaves by dropping them. Limits are the same for every process of
//! a fleet; the first process to open a service creates it.
//!
//! | port | direction | payload |
//! |---|---|---|
//! | [`SampleWriter`] → [`SampleReader`] | sources → worker | [`joulebus_wire::Sample`] |
//! | [`ForecastWriter`] → [`ForecastReader`] | worker → planners | [`joulebus_wire::Forecast`] |
//! | [`DiagnosticWriter`] → [`DiagnosticReader`] | worker → planners | [`joulebus_wire::Diagnostic`] |
//! | [`BudgetWriter`] → [`BudgetReader`] | worker → planners | [`joulebus_wire::Budget`], history 1 |
//! | [`PlanStateWriter`] → [`PlanStateReader`] | worker → planners | [`joulebus_wire::PlanState`], history 1, while somebody reads |
//! | [`StateWriter`] → [`StateReader`] | worker → recorders | bytes of keyframes |
//! | [`QueriesWriter`] → [`QueriesReader`] | worker → recorders | [`joulebus_wire::QueryRecord`]s, history 1 |
//! | [`QueryClient`] ⇄ [`QueryServer`] | planners ⇄ worker | [`joulebus_wire::QueryHeader`] and values, [`joulebus_wire::AnswerHeader`] and words |
//! | [`TickWriter`] → [`TickReader`] | worker → recorders | [`joulebus_wire::TakenFrame`] |
//! | [`Waker`] → [`Waiter`] | sources → worker, worker → planners | events |
//!
//! Ports, the [`Bus`] and the [`Waiter`] belong to the thread that made them. Every member runs a
//! cleanup thread that removes stale files of dead processes ([`Bus::housekeeping`]). The last
//! member to leave removes everything of the domain, in `/dev/shm` and in the root directory; what joulebus
//! did not make, by its marker and names, it neither changes nor removes. A member whose own files are
//! removed gets [`FilesRemoved`] from every port.
//!
//! Behaviour of iceoryx2 0.10.0 that this crate compensates for, each with a test:
//! - Opening a shared-memory object of length zero blocks indefinitely, not only while joining: a process
//!   killed between creating and sizing a connection also blocks living members in their next send
//!   or receive. The cleanup threads remove such files once no process has them open.
//! - A creator killed before it has finished leaves a service that fails with `HangsInCreation` for
//!   ever, or a node that counts as starting and is never removed; an incomplete tag keeps a dead node
//!   from being removed. A process that creates or uses an object has its file open, so what is
//!   incomplete, old, and open in no process is removed.
//! - Dead nodes are locked one by one, not the services that they share: two processes that remove two of them can remove
//!   a service that a third has just created anew. Processes of a domain take turns.
//! - A connection that could not be established is not retried until the list of ports changes. If
//!   its port is still listed three seconds later, a reader recreates its own port, and a writer lets
//!   a reader join for a moment, which changes the list.
//! - Objects are sized, and their pages are allocated at the first access, which raises SIGBUS in a
//!   full `/dev/shm`: ours are allocated completely when they are created.
//! - The object that counts nodes (`…global_mgmt`) is readable and writable by every user of the
//!   host if another iceoryx2 program created it: [`Bus::join`] restricts it to its owner.
#![deny(unsafe_code)]

mod bus;
mod cleanup;
mod directory;
mod iceoryx_config;
mod inspect;
mod ipc;
mod liveness;
mod marker;
mod membership;
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
pub use inspect::{InspectError, Inspection, NodeInfo, RootInfo, inspect};
pub use joulebus_domain::{Domain, DomainError, Limits, LimitsError, STANDBY_FILES, Scheduling};
pub use liveness::peer_watch::PeerWatch;
pub use liveness::presence::FilesRemoved;
pub use liveness::worker_lock::{WorkerLock, WorkerLockError, WorkerOwner};
pub use membership::JoinError;
pub use os::background::{Background, Panicked, Steps};
pub use os::clock;
pub use os::memory::touch_own_memory;
pub use os::process_id;
pub use os::scheduling::{
    Rights, SchedulingError, page_faults, schedule_process, schedule_thread, set_timer_slack,
    try_scheduling, yield_to_the_worker,
};
pub use ports::{
    BudgetReader, BudgetWriter, DiagnosticReader, DiagnosticWriter, ForecastReader, ForecastWriter,
    Frame, FrameBuf, IncomingFrame, KeptFrame, Loan, OpenError, OpenQuery, PlanStateReader,
    PlanStateWriter, Poller, QueriesReader, QueriesWriter, QueryClient, QueryError, QueryServer,
    Reader, ReceiveError, SampleReader, SampleTap, SampleWriter, SendError, StateReader,
    StateWriter, TickReader, TickWriter, WaitError, Waiter, Waker, Woken, Writer,
};
pub use preflight::{CapacityError, CapacityReport, Ports, check_capacity};
pub use private::{DomainWarning, RootError};
