//! Files that a standby worker and the link of its host exchange.
//!
//! | file | written by | contents |
//! |---|---|---|
//! | permit | the link | term, and the instant after which the worker must be silent |
//! | keyframe | the leading worker | its state, once a second |
//! | replica | the link | the keyframe of the leader on another host |
//!
//! They are files because those survive a kill of any of the processes, are replaced whole (by
//! renaming), and cost a tick nothing. Files of an earlier boot count as missing.

mod files;
mod permit;
mod saved_state;

pub use files::StandbyFiles;
pub use permit::{Permit, PermitError};
pub use saved_state::{SavedState, SavedStateError};
