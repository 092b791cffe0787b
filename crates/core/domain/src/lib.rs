//! Agreements of all processes of a fleet before they join its shared memory, and requests of its
//! worker to the host: plain values with their rules.
//!
//! Nothing here opens shared memory. `joulebus-bus` does so with these values.
//!
//! ```
//! use std::path::Path;
//!
//! use joulebus_domain::{Domain, Limits};
//!
//! let domain = Domain::new("lab", Path::new("/dev/shm/joulebus-1000"), "jb_")?;
//! assert_eq!(domain.directory(), Path::new("/dev/shm/joulebus-1000/lab"));
//! assert!(domain.shm_prefix().starts_with("jb_"));
//!
//! let limits = Limits { capacity: 20, ..Limits::default() }.checked()?;
//! assert_eq!(limits.max_planners, 8);
//! let refused = Limits { max_planners: 0, ..limits }.checked().unwrap_err();
//! assert!(refused.to_string().contains("max_planners"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! **Three types to know.** A [`Domain`] states where the shared memory of a fleet lies. Two
//! domains never touch each other's objects. [`Limits`] states how many robots, sources and
//! planners the fleet can have, from which the size of each service follows ([`Shape`]). A
//! [`Scheduling`] is what the worker requests for its threads.
//!
//! **Units.** Limits are counts: of robots, processes and frames. Sizes are in bytes.
//!
//! **Errors** state the value and the allowed ones: [`DomainError`] and [`LimitsError`].
//!
//! **In the book**: [files and shared memory][1], [limits][2], [several fleets on one host][3].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/reference/files.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/reference/limits.md
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/how-to/several-fleets.md
#![forbid(unsafe_code)]

mod domain;
mod limits;
mod scheduling;

pub use domain::{Domain, DomainError, FLEET_MARKER, RAISES_FILE, SHM_DIR, STANDBY_FILES};
pub use limits::{ACTIVE_QUERIES, Limits, LimitsError, Shape};
pub use scheduling::Scheduling;
