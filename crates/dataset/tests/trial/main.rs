//! Recorded trials: what is read, what is refused, what is said and what is sent.

#![allow(clippy::unwrap_used)] // A test that cannot write or read its own files has failed.

mod files;
mod fleet;
mod read;
mod recordings;
mod samples;
mod truncation;
