//! Networks for tests: random ones, and model files with arbitrary contents.
#![allow(missing_docs)] // Used by tests alone.
#![forbid(unsafe_code)]

pub mod forged;
pub mod random;
