//! A worker that serves with a permit only: of several that can serve the same robots, on several hosts, one does.
//!
//! Who may is decided elsewhere: the link of this host, or whoever writes the permit. Worker and link leave each other
//! files in the fleet's private directory:
//!
//! | file | written by | |
//! |---|---|---|
//! | permit | the link | term, and the instant after which the worker must be silent |
//! | keyframe | the worker that serves | its state, once a second |
//! | replica | the link | the keyframe of the worker elsewhere that serves |
//! | request | `joulebus link FILE --take-over` | the command that this host's worker shall serve |
//!
//! Files, because they are there after any of the processes was killed, are replaced whole (by renaming), and cost a tick
//! nothing.

pub(crate) mod backlog;
pub(crate) mod follow;
mod permit;
mod places;
pub(crate) mod restore;
mod saved_state;
pub(crate) mod watch;

pub use permit::{Permit, PermitError};
pub use places::Places;
pub use saved_state::{SavedState, SavedStateError};
pub use watch::PermitOver;
