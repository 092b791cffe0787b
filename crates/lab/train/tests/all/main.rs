//! The tests of training.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod energy;
mod linear;
mod train;
