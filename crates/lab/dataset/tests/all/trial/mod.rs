//! Recorded trials: reading, refusals, notes and samples.

mod fleet;
mod read;
mod real;
mod samples;
mod text;
mod truncation;
