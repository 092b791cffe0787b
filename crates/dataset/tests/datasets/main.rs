//! Datasets: what is found wrong with them, what is written and resampled.

#![allow(clippy::unwrap_used)] // A test that cannot write or read its own files has failed.

mod check;
mod convert;
#[allow(dead_code)] // The tests of reading use all of it, these a part.
#[path = "../trial/files.rs"]
mod files;
mod recordings;
mod resample;
