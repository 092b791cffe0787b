//! Networks for tests: random ones, and model files with arbitrary contents.
#![forbid(unsafe_code)]

pub mod forged;
pub mod random;
