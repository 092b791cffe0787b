//! The bus: everything that happens in shared memory, and the only crate that names iceoryx2.
//!
//! A [`Domain`] says where a fleet's shared memory lives. A process joins it with [`Bus::join`],
//! opens the ports it needs, and leaves by dropping them. Limits are the same for every process of
//! a fleet; whoever comes first creates a service.
//!
//! | port | direction | payload |
//! |---|---|---|
//! | [`SampleWriter`] → [`SampleReader`] | sources → worker | [`joulebus_wire::Sample`] |
//! | [`ForecastWriter`] → [`ForecastReader`] | worker → planners | [`joulebus_wire::Forecast`] |
//! | [`DiagnosticWriter`] → [`DiagnosticReader`] | worker → planners | [`joulebus_wire::Diagnostic`] |
//! | [`BudgetWriter`] → [`BudgetReader`] | worker → planners | [`joulebus_wire::Budget`], history 1 |
//! | [`StateWriter`] → [`StateReader`] | worker → recorders | bytes of keyframes |
//! | [`TickWriter`] → [`TickReader`] | worker → recorders | [`joulebus_wire::TakenFrame`] |
//! | [`Waker`] → [`Waiter`] | sources → worker, worker → planners | events |
//!
//! Ports, the [`Bus`] and the [`Waiter`] belong to the thread that made them. Every member has a
//! small keeper thread that removes what dead processes leave behind ([`Bus::housekeeping`]).
//! When the last member leaves, nothing of the domain is left, neither in `/dev/shm` nor in the
//! root directory.
//!
//! Facts of iceoryx2 0.10.0 that this crate answers for, each with a test:
//! - Who opens a shared-memory object of length zero waits for it for ever, not only while
//!   joining: a process killed between creating and sizing a connection stops living members in
//!   their next send or receive too. So each keeper removes such files, as long as nobody holds
//!   them open.
//! - A creator killed half-way leaves a service that fails with `HangsInCreation` for ever, or a node
//!   that counts as starting and is never removed; a half-written tag keeps a dead node from being
//!   removed. Whoever makes or uses something has its file open: what is unfinished, old, and open
//!   in no process is removed.
//! - A connection that could not be made is never tried again until the list of ports changes:
//!   readers make their port anew.
//! - The object that counts nodes (`…global_mgmt`) is readable and writable by every user of the
//!   host: [`Bus::join`] takes that right away.
#![deny(unsafe_code)]

mod bus;
mod cleanup;
mod domain;
mod iceoryx_config;
mod inspect;
mod limits;
mod liveness;
mod membership;
mod os;
mod ports;
mod preflight;

pub use bus::Bus;
pub use cleanup::keeper::Housekeeping;
pub use cleanup::report::SweepReport;
pub use cleanup::sweep::{SweepError, sweep};
pub use domain::{Domain, DomainError, DomainWarning, RootError};
pub use iceoryx_config::IceoryxConfigError;
pub use inspect::{InspectError, Inspection, NodeInfo, RootInfo, inspect};
pub use limits::{Limits, LimitsError};
pub use liveness::peer_watch::PeerWatch;
pub use liveness::worker_lock::{WorkerLock, WorkerLockError};
pub use membership::JoinError;
pub use os::clock;
pub use os::memory::touch_own_memory;
pub use os::scheduling::{Rights, Scheduling, SchedulingError, page_faults, set_timer_slack};
pub use ports::{
    BudgetReader, BudgetWriter, DiagnosticReader, DiagnosticWriter, ForecastReader, ForecastWriter,
    Frame, FrameBuf, IncomingFrame, Loan, OpenError, Reader, ReceiveError, SampleReader, SampleTap,
    SampleWriter, SendError, StateReader, StateWriter, TickReader, TickWriter, WaitError, Waiter,
    Waker, Woken, Writer,
};
pub use preflight::{CapacityError, CapacityReport, Ports, check_capacity};
