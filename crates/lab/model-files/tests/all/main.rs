//! The tests of other programs' model files: read, written, damaged and hostile.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod damaged_models;
mod fixture;
mod model_files;
mod other_networks;
mod pickles;
mod python;
mod wrapped;

use joulebus_testkit::counting::Counting;

#[global_allocator]
static ALLOCATOR: Counting = Counting;
