//! Recorded trials: what is read, what is refused, what is said, what is sent, and what comes of it.

#![allow(clippy::unwrap_used)] // A test that cannot write or read its own files has failed.

mod evaluation;
mod files;
mod fleet;
#[path = "../live/mod.rs"]
mod live;
mod model;
#[allow(dead_code, reason = "its rows")]
#[path = "../../../predictor/tests/random/mod.rs"]
mod random;
mod read;
mod recordings;
mod rows;
mod samples;
mod score;
mod truncation;
