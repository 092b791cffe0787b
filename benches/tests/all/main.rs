//! The tests of the benchmarks' program.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod program;
