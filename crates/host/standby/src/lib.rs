//! The files through which a standby worker and the link of its host communicate, in the fleet's
//! private directory.
//!
//! A part of the programs `joulebus` (`run --standby`) and `joulebus-link`.
//!
//! | file | written by | contents |
//! |---|---|---|
//! | [permit](Permit) | the link | term, and the instant after which the worker must be silent |
//! | [keyframe](SavedState) | the leading worker | its state, once a second |
//! | [replica](SavedState) | the link | the keyframe of the leader on another host |
//!
//! They are files because those survive a kill of any of the processes, are replaced whole (by
//! renaming), and cost a tick nothing.
//!
//! **Three types to know.** [`Places`] has the paths of the three files. A [`Permit`] allows this
//! host's worker to publish. A [`SavedState`] is the state of a fleet, with its origin.
//!
//! **Units** are ns. A permit counts them since boot with suspend, so that a host that slept does
//! not take an old permit for a valid one. Files of an earlier boot count as missing.
//!
//! **Errors** name the file: [`PermitError`] and [`SavedStateError`]. After a failed write the file
//! before is in force.
//!
//! **In the book**: [add a standby worker][1], [only the lease holder publishes][2], [files and
//! shared memory][3].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/how-to/standby.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/several-hosts.md#only-the-lease-holder-publishes-judged-by-its-own-clock
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/reference/files.md
#![forbid(unsafe_code)]

mod permit;
mod places;
mod saved_state;

pub use permit::{Permit, PermitError};
pub use places::Places;
pub use saved_state::{SavedState, SavedStateError};
