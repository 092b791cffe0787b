//! What a worker that stands by and the link of its host leave each other: files in the fleet's
//! private directory.
//!
//! | file | written by | |
//! |---|---|---|
//! | [permit](Permit) | the link | term, and the instant after which the worker must be silent |
//! | [keyframe](SavedState) | the worker that serves | its state, once a second |
//! | [replica](SavedState) | the link | the keyframe of the worker elsewhere that serves |
//! | request | `joulebus link FILE --take-over` | the command that this host's worker shall serve |
//!
//! Files, because they are there after any of the processes was killed, are replaced whole (by
//! renaming), and cost a tick nothing.
#![forbid(unsafe_code)]

mod permit;
mod places;
mod saved_state;

pub use permit::{Permit, PermitError};
pub use places::Places;
pub use saved_state::{SavedState, SavedStateError};
