//! Tests that may run for hours: fleets with random faults, and a thousand robots.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod random_faults;
mod soak;
