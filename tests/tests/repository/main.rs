//! The tests of the repository itself: dependency rules, packages, links of documents, alert rules,
//! and the seeds of the fuzz targets.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod alert_rules;
mod api;
mod dependency_rules;
mod fuzz_inputs;
mod links;
mod packaging;
