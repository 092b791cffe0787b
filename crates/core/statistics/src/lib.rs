//! Statistics that the offline crates share: error sums and quantiles, bootstrap intervals, bounds
//! of rates, and random numbers that are the same on every machine.
//!
//! Pure: numbers in, numbers out.
//!
//! ```
//! use joulebus_statistics::metrics::{quantile, sorted, tally};
//! use joulebus_statistics::noise::Noise;
//!
//! let (readings_w, forecasts_w) = ([4.0, 5.0, 6.0], [4.5, 5.0, 5.5]);
//! let tally = tally(&readings_w, &forecasts_w, 0.1);
//! assert_eq!(tally.r2(), 0.75);
//! assert_eq!(tally.bias_w(), 0.0);
//! assert_eq!(quantile(&sorted([3.0, 1.0, 2.0]), 0.5), 2.0);
//!
//! let (mut one, mut other) = (Noise::new(7, 0), Noise::new(7, 0));
//! assert_eq!(one.normal(), other.normal());
//! ```
//!
//! **Three types to know.** A [`Tally`](metrics::Tally) has the sums of pairs of readings and
//! forecasts, from which all scores follow. A [`Bootstrap`](bootstrap::Bootstrap) gives a score its
//! confidence interval. A [`Noise`](noise::Noise) is a seeded stream of random numbers.
//!
//! Beside them, [`order`] finds quantiles of numbers that are too many for memory, and [`poisson`]
//! bounds a rate from a count.
//!
//! **Units** are W, s and J where the name states it. All else has the unit of its input.
//!
//! **Errors.** A score that is undefined is NaN. A pair that is not finite is counted as unscored.
//! Only [`order::residual_quantiles`] can fail, with the error of its caller.
//!
//! **In the book**: [how forecasters are scored][1], [a benchmark of energy forecasting][2].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/training-evaluation.md#all-forecasters-are-scored-on-the-same-rows-with-intervals-over-blocks
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/measured/benchmark.md
#![forbid(unsafe_code)]

pub mod bootstrap;
pub mod metrics;
pub mod noise;
pub mod order;
pub mod poisson;
