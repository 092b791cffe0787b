//! Datasets: checking, converting and resampling.

mod check;
mod convert;
mod judge;
mod resample;
