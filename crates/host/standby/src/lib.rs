#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod permit;
mod places;
mod saved_state;

pub use permit::{Permit, PermitError};
pub use places::Places;
pub use saved_state::{SavedState, SavedStateError};
