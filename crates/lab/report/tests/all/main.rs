//! The tests of reports and their figures.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod report;
