//! Tests of configs: the shipped ones, refusals, and the limits of recordings.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod recordings;
mod refused;
mod shipped;
