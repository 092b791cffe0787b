//! Members of a domain, in this process and in others.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod beside;
mod connections;
mod harness;
mod logging;
mod processes;
mod readiness;
mod reading;
mod root;

/// Not a test: the entry point of members started by the tests.
#[test]
fn member() {
    harness::run_member();
}
