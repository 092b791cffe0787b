//! The format of captures: bits, schemas, limits, and files of other programs.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod bag;
mod bits;
mod conformance;
mod declared;
mod earlier;
#[path = "../fields/mod.rs"]
mod fields;
mod import;
mod layouts;
mod limits;
mod real;
mod schemas;
mod small_files;
