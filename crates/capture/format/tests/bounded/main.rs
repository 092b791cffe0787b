//! Memory and work are bounded, for damaged files and for long ones. Allocations are counted, so
//! these tests have a program of their own.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod damage;
mod damaged;
#[path = "../fields/mod.rs"]
mod fields;
mod heal;
mod long_files;

use joulebus_testkit::counting;

#[global_allocator]
static ALLOCATOR: counting::Counting = counting::Counting;
