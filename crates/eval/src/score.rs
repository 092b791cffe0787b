//! Evaluation: how good a model is on recordings, beside what it has to beat.
//!
//! Two modes, both on the same rows and beside the same baselines:
//!
//! - *Corrected*: each forecast rests on real readings and looks one tick ahead. Forecasts and
//!   intervals are those of the live tick, to the bit ([`crate::evaluate`]).
//! - *Open loop*: from an origin on, a forecaster is fed with its own forecasts, the commands being
//!   known, and is scored at chosen horizons ([`Horizon`]).
//!
//! The baselines are persistence (the last reading again) and linear models of the last readings
//! and the velocities ([`joulebus_train::linear`]), fitted on rows that are not evaluated ([`Design`]).
//!
//! A row is scored if five readings without a gap lie behind it, a reading follows it, and every
//! model has a forecast for it: so all forecasters stand on the same rows. What is left out is
//! counted.
//!
//! Everything has the same bits for any number of threads: each recording is summed in the order of
//! its rows, recordings are merged in the order they are given in.

mod blocks;
mod cell;
mod compare;
mod corrected;
mod design;
mod open_loop;
mod options;
mod recording;
mod report;
mod run;
mod subject;
mod text;

pub use cell::{Blocks, Cell, ForecasterScore, Horizon, HorizonCell, HorizonScore, Skill};
pub use compare::{Comparison, Difference, Verdict, compare};
pub use design::{Design, DesignReport, Fold, Part};
pub use open_loop::origins;
pub use options::{LONGEST_HORIZON, Options, ScoreError};
pub use recording::{Recording, check_apart, read_recordings, recorded_platform};
pub use report::{BaselineReport, ModelReport, ScoreReport};
pub use run::{Scored, score};
pub use subject::Subject;
