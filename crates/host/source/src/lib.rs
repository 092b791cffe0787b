//! Shared code of the programs that are sources of samples: a publisher that finds a worker,
//! follows its answers, and reports the fate of the samples.
//!
//! `joulebus publish sim` and `replay` are in the main program. `publish trial` reads recordings
//! and is in `joulebus-lab`.
#![forbid(unsafe_code)]

pub mod flow;
pub mod link;
pub mod rate;
pub mod report;
pub mod window;
