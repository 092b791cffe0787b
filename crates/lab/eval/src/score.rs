//! Scores of models on recordings, compared with baselines.
//!
//! Each forecast is based on real readings, one tick ahead. Forecasts and intervals are those of the
//! live tick, to the bit ([`crate::evaluate`]).
//!
//! The scored forecast is the one that would be published
//! ([`Forecast`](crate::evaluate::Forecast)). The members of an online forecast are scored beside
//! it.
//!
//! The baselines are persistence and linear models of the last readings and the velocities
//! ([`joulebus_train::linear`]), fitted on rows that are not evaluated ([`Design`]). Further ones,
//! among them other programs' forecasts, are scored one tick ahead only ([`Reference`]).
//!
//! A model's file identifies the rows it was trained on. Those are scored apart
//! ([`Design::hold_apart`]).
//!
//! A row is scored if five gapless readings precede it, a reading follows it, and every model has a
//! forecast for it, so all forecasters are scored on the same rows. The other rows are counted.
//!
//! Results have the same bits for any number of threads: each recording is summed in the order of
//! its rows, and recordings are merged in the given order.

mod blocks;
mod cell;
mod common;
mod compare;
mod corrected;
mod design;
mod error;
mod kept;
mod members;
mod open;
mod options;
mod recording;
mod references;
mod report;
mod run;
mod subject;
mod tallied;
mod text;
mod trained_on;

pub use cell::{Blocks, Cell, ForecasterScore, IntervalScore, Role, Skill};
pub use common::{BaselineReport, ModelReport};
pub use compare::{Comparison, Difference, FEWEST_TRIALS, MemberScore, Verdict, compare};
pub use design::{Design, DesignReport, Fold, Part};
pub use error::ScoreError;
pub(crate) use open::each;
pub use open::{ROWS_IN_MEMORY, open_recordings, read_recordings};
pub use options::Options;
pub(crate) use recording::sources;
pub use recording::{Contents, Recording, check_apart, recorded_platform};
pub use references::{Foreign, Reference};
pub use report::ScoreReport;
pub use run::{Scored, score, score_reported, score_watched};
pub use subject::Subject;
pub use tallied::ConstantInterval;
pub use trained_on::{ScoredRows, TrainedOn};
