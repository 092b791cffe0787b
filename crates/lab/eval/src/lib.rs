//! Offline evaluation: forecasts of recordings by the live code, scores with intervals, and
//! analysis of datasets.
//!
//! ```
//! use joulebus_eval::evaluate::{Forecast, evaluate_trial};
//! use joulebus_plant::{parts::Parts, protocol::Protocol};
//! use joulebus_predictor::{Model, Persistence, ResidualStats};
//!
//! let text = "[fleet]\nname = \"lab\"\n[[platform]]\nfile = \"builtin:gternal\"\nrobots = [7]\n";
//! let config = joulebus_config::Config::parse(text, std::path::Path::new("."))?;
//! let residual = ResidualStats { std_w: 0.1, q05_w: -0.2, q95_w: 0.2 };
//! let models = [Model::Persistence(Persistence::new(residual)?)];
//! // A recording of a simulated robot. `Trial::read` has those of files.
//! let trial = joulebus_sim::protocol::drive_with(Protocol::RandomWalk, Parts::default(), 7, 300);
//!
//! let robot = evaluate_trial(config.settings(), &models, 7, &trial)?;
//! assert_eq!(robot.forecast, Forecast::Persistence);
//! assert_eq!((robot.accepted, robot.steps.len()), (300, 300));
//! assert!(robot.scores.mae_w() < 1.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! **Three types to know.** An [`Evaluation`](evaluate::Evaluation) is what the tick would have
//! published live, to the bit. A [`Design`](score::Design) states which rows are scored, and which
//! the baselines are fitted on. A [`ScoreReport`](score::ScoreReport) has the scores of a model
//! beside its baselines, with confidence intervals.
//!
//! **Modules.** [`energy`] scores the energy over horizons, [`calibrate`] chooses limits of alarms,
//! [`analyze`] describes datasets, [`online_learning`] judges online forecasts, and
//! [`training_data`] chooses the rows to train on.
//!
//! **Units** are W, J, s and ns. A score that is undefined is NaN, and null in JSON.
//!
//! **Errors** state what was found, what is allowed and the remedy:
//! [`EvaluateError`](evaluate::EvaluateError), [`ScoreError`](score::ScoreError).
//!
//! **In the book**: [resample, split and evaluate][1], [how forecasters are scored][2], [calibrate
//! alarms][3], [a benchmark][4].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/how-to/resample-and-split.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/training-evaluation.md#all-forecasters-are-scored-on-the-same-rows-with-intervals-over-blocks
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/how-to/calibrate-alarms.md
//! [4]: https://github.com/joulebus/joulebus/blob/main/docs/measured/benchmark.md
#![forbid(unsafe_code)]

pub mod analyze;
pub mod calibrate;
pub mod energy;
pub mod evaluate;
pub mod online_learning;
mod report;
pub mod score;
pub mod training_data;

pub use report::EvalReport;
