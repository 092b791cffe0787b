//! The tests of configs: what is shipped, what is refused, and what recordings hold.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod recordings;
mod refused;
mod shipped;
