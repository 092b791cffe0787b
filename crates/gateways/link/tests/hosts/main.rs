//! Real links between hosts with their own shared memory, workers, robots and planners.
#![forbid(unsafe_code)]
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod certificates;
mod etcd;
mod fleets;
mod host;
mod local;
mod namespaces;
mod planner;
mod router;
mod speed;
mod standby;
mod strangers;
mod sums;
mod takeovers;

/// Not a test: the entry point of the processes that the tests start.
#[test]
fn member() {
    planner::run();
    router::run();
    speed::run();
}
