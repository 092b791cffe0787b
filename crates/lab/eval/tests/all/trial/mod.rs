//! Recorded trials through the live code: forecasts, rows, scores.

mod evaluation;
mod model;
mod rows;
mod score;
mod stored;
