//! Tests of plans: the energy of a path, a fleet's answers, and the cost of both.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod allocations;
mod everyday;
mod follower;
mod question_cost;
mod questions;
mod what_if;
mod world;

use joulebus_testkit::counting::Counting;

#[global_allocator]
static ALLOCATOR: Counting = Counting;
