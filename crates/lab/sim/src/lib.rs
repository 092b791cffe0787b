//! Recordings of simulated robots: the paper's six trials, its seven robots, and training data.
//!
//! The robots themselves are those of [`joulebus_plant`]. Nothing here writes a file.
//!
//! ```
//! use joulebus_sim::protocol::trial;
//! use joulebus_sim::scenario::seven_robots;
//!
//! let extremes = trial(4, 7)?;
//! assert_eq!(extremes.rows(), 8_000);
//! let robots = seven_robots(7, 100);
//! assert_eq!(robots.len(), 7);
//! assert_eq!(trial(9, 7).unwrap_err().to_string(), "trial 9: allowed are 1 to 6");
//! # Ok::<(), joulebus_plant::protocol::UnknownTrial>(())
//! ```
//!
//! **Three types to know.** Each recording is a [`Trial`](joulebus_dataset::trial::Trial), from
//! [`protocol`] or [`scenario`]. A [`SimulatedData`](training_data::SimulatedData) states how many
//! robots to simulate for a [`Dataset`](joulebus_dataset::rows::Dataset). A
//! [`Barrier`](barrier::Barrier) keeps robots apart.
//!
//! **The same bits.** A seed determines every row, on every machine.
//!
//! **Units** are those of [`joulebus_dataset`]: SI.
//!
//! **Errors.** [`UnknownTrial`](joulebus_plant::protocol::UnknownTrial) for a trial that the paper
//! does not have, and [`BarrierError`](barrier::BarrierError) for robots that cannot be kept apart.
//!
//! **In the book**: [the simulated robots][1], [the simulated robots beside the paper][2], [a plant
//! judged over ten seeds][3].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/explanation/plant.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/measured/plant.md
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/training-evaluation.md#one-simulated-plant-judged-over-ten-seeds
#![forbid(unsafe_code)]

pub mod barrier;
pub mod protocol;
mod recorder;
pub mod scenario;
pub mod training_data;
