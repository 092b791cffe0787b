#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod domain;
mod limits;
mod scheduling;

pub use domain::{
    Domain, DomainError, FLEET_MARKER, RAISES_FILE, REFUSALS_FILE, SHM_DIR, STANDBY_FILES,
};
pub use limits::{ACTIVE_QUERIES, Limits, LimitsError, Shape};
pub use scheduling::Scheduling;
