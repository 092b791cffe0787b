//! What the programs share that are sources of samples: a publisher that finds a worker, follows
//! what it answers, and reports what became of the samples.
//!
//! `joulebus publish sim` and `replay` are in the main program; `publish trial` reads recordings and
//! is in `joulebus-lab`.
#![forbid(unsafe_code)]

pub mod flow;
pub mod link;
pub mod rate;
pub mod report;
pub mod window;
