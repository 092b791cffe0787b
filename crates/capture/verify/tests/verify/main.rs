//! Verification of captures.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod differences;
mod mutations;
mod simulation;
mod speed;
