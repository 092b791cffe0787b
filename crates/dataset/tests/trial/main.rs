//! Recorded trials: reading, refusals, notes and samples.

#![allow(clippy::unwrap_used)] // A test that cannot read or write its own files fails.

mod files;
mod fleet;
mod read;
mod real;
#[path = "../../../../tests/recordings.rs"]
mod recordings;
mod samples;
mod truncation;
