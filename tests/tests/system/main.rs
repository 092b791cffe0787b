//! Tests of whole fleets: real processes, shared memory and signals, each in a domain of its own.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod batteries;
mod captures;
mod clocks;
mod confined;
mod cut_short;
mod examples;
mod floods;
mod foreign_files;
mod full_memory;
mod lock_owners;
mod models;
mod publishers;
mod questions;
mod random_faults;
mod recorders;
mod removed_files;
mod replays;
mod same_bits;
mod samples;
mod soak;
mod stale_cleanup;
mod starts;
mod strangers;
mod workers;
