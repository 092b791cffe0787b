//! Recorded trials through the live code: forecasts, rows, scores.

#![allow(clippy::unwrap_used)] // A test that cannot read or write its own files fails.

mod evaluation;
#[allow(dead_code)] // The tests of reading use all of it, these only a part.
#[path = "../../../dataset/tests/trial/files.rs"]
mod files;
#[path = "../live/mod.rs"]
mod live;
mod model;
#[allow(dead_code, reason = "its rows")]
#[path = "../../../predictor/tests/random/mod.rs"]
mod random;
#[path = "../../../../tests/recordings.rs"]
mod recordings;
mod rows;
mod score;
mod stored;
