//! The tests of the C library: its header and layouts, and programs that use it.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod layouts;
mod programs;

/// Not a test: the entry point of the processes that the tests start.
#[test]
fn member() {
    programs::member();
}
