//! Recorded trials: reading, refusals, notes and samples.

mod fleet;
mod forms;
mod parts;
mod read;
mod real;
mod runs;
mod samples;
mod text;
mod truncation;
