//! Shared code of all joulebus programs: arguments, output, exit codes.
//!
//! Results go to stdout, everything else to stderr. [`exit`] defines the exit codes. A verb that is
//! a separate program has its `main` in [`verb`], and [`described`] gives its options to
//! `joulebus`.
#![forbid(unsafe_code)]

pub mod config_file;
pub mod described;
pub mod exit;
pub mod exit_with_parent;
pub mod file;
pub mod installed;
pub mod logging;
pub mod model_range;
pub mod model_source;
pub mod options;
pub mod output;
pub mod platform;
pub mod shell;
pub mod stop;
pub mod utc;
pub mod verb;
