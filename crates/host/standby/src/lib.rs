//! The files through which a standby worker and the link of its host communicate, in the fleet's
//! private directory.
//!
//! | file | written by | contents |
//! |---|---|---|
//! | [permit](Permit) | the link | term, and the instant after which the worker must be silent |
//! | [keyframe](SavedState) | the leading worker | its state, once a second |
//! | [replica](SavedState) | the link | the keyframe of the leader on another host |
//! | request | `joulebus link FILE --take-over` | the request that this host's worker leads |
//!
//! They are files because those survive a kill of any of the processes, are replaced whole (by
//! renaming), and cost a tick nothing.
#![forbid(unsafe_code)]

mod permit;
mod places;
mod saved_state;

pub use permit::{Permit, PermitError};
pub use places::Places;
pub use saved_state::{SavedState, SavedStateError};
