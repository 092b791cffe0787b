//! The tests of one tick: against its reference, of its parts, and of its memory.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod allocations;
mod battery;
mod before;
mod budgets;
mod capacity;
mod day;
mod independence;
mod intake;
mod left_out;
mod levels;
mod limits;
mod oracle;
mod pauses;
mod recycling;
mod remembered;
mod shards;
mod state_cost;
mod time_to_empty;

use joulebus_testkit::counting::Counting;

#[global_allocator]
static ALLOCATOR: Counting = Counting;
