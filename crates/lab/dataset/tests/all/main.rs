//! Tests of datasets: trials, rows, and the operations on them.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod datasets;
mod rows;
mod sources;
mod trained_rows;
mod trial;
