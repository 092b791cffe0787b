//! Datasets: checking, converting and resampling.

#![allow(clippy::unwrap_used)] // A test that cannot read or write its own files fails.

mod check;
mod convert;
#[allow(dead_code)] // The tests of reading use all of it, these only a part.
#[path = "../trial/files.rs"]
mod files;
#[path = "../../../../tests/recordings.rs"]
mod recordings;
mod resample;
