//! The tests of networks of other programs that are imported, and of models that are exported.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod exports;
mod imports;
mod plain;
mod python;
mod statements;
