//! What all processes of a fleet agree on before they join its shared memory, and what its worker
//! asks of the host: plain values with their rules. Nothing here opens shared memory.
#![forbid(unsafe_code)]

mod domain;
mod limits;
mod scheduling;

pub use domain::{Domain, DomainError, FLEET_MARKER, SHM_DIR, STANDBY_FILES};
pub use limits::{ACTIVE_QUERIES, Limits, LimitsError, Shape};
pub use scheduling::Scheduling;
