//! The tests of the repository itself: dependency rules, packages, what documents name, and the
//! seeds of the fuzz targets.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod api;
mod cards;
mod dependency_rules;
mod documents;
mod fuzz_inputs;
mod packaging;
