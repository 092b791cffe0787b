//! The tests of planners' clients, beside workers in processes of their own.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod allocations;
mod processes;

use joulebus_testkit::counting::Counting;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Not a test: the entry point of the processes that the tests start.
#[test]
fn member() {
    processes::member();
}
