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
mod recording;
mod report;
mod text;

use joulebus_predictor::Model;
use joulebus_settings::{FleetSettings, Platform};
use rayon::prelude::*;

use crate::evaluate::{EvaluateError, Evaluation, RobotEvaluation};
use joulebus_dataset::split::SplitError;
use joulebus_statistics::bootstrap::Bootstrap;
use joulebus_train::linear::{LinearError, Terms};

pub use cell::{Blocks, Cell, ForecasterScore, Horizon, HorizonCell, HorizonScore, Skill};
pub use compare::{Comparison, Difference, Verdict, compare};
pub use design::{Design, DesignReport, Fold, Part, fit_lines};
pub use open_loop::origins;
pub use recording::{Recording, check_apart, read_recordings, recorded_platform};
pub use report::{BaselineReport, ModelReport, ScoreReport};

/// The longest horizon, ticks.
pub const LONGEST_HORIZON: usize = 300;

/// How recordings are evaluated.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Horizons of the open loop, ticks, ascending, each 1 to [`LONGEST_HORIZON`]; empty for none.
    pub horizons: Vec<usize>,
    /// Rows from one origin of the open loop to the next; at least 1.
    pub origins_every: usize,
    /// Linear models to stand beside persistence.
    pub baselines: Vec<Terms>,
    /// The confidence intervals.
    pub bootstrap: Bootstrap,
}

impl Default for Options {
    /// Horizons of 1 to 300 ticks in half decades, an origin every 10 rows, AR(5) and AR(5) +
    /// velocities.
    fn default() -> Self {
        Self {
            horizons: vec![1, 3, 10, 30, 100, 300],
            origins_every: 10,
            baselines: vec![Terms::AR5, Terms::AR5_AND_VELOCITIES],
            bootstrap: Bootstrap::default(),
        }
    }
}

/// Why recordings could not be evaluated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ScoreError {
    /// Nothing was given.
    #[error("found no recording to evaluate; name one or more files")]
    NoRecording,
    /// No model was given.
    #[error("found no model to evaluate; name one")]
    NoModel,
    /// Nothing can be scored.
    #[error(
        "none of the {rows} rows of {recordings} recordings can be evaluated: a row needs five \
         readings without a gap behind it, a reading after it, and a forecast; name longer or more \
         recordings"
    )]
    NoRows {
        /// Recordings.
        recordings: usize,
        /// Their rows.
        rows: usize,
    },
    /// A horizon is not allowed.
    #[error("horizon {found} after {before}: allowed are 1 to {LONGEST_HORIZON} ticks, ascending")]
    Horizon {
        /// The horizon.
        found: usize,
        /// The one before it, or 0.
        before: usize,
    },
    /// A number is not allowed.
    #[error("{what} is {found}, allowed is {allowed}")]
    Option {
        /// Which.
        what: &'static str,
        /// What it is.
        found: f64,
        /// What it may be.
        allowed: &'static str,
    },
    /// The design has rows that the recordings have not.
    #[error(
        "the design of other recordings: it has row {found} of recording {recording}, which has \
         {allowed} rows; make it from the recordings that are evaluated"
    )]
    Design {
        /// Number of the recording.
        recording: usize,
        /// Row asked for.
        found: usize,
        /// Rows there are.
        allowed: usize,
    },
    /// The split is not possible.
    #[error(transparent)]
    Split(#[from] SplitError),
    /// The live path refused.
    #[error(transparent)]
    Evaluate(#[from] EvaluateError),
    /// A baseline has other features than its moments; never from data.
    #[error(transparent)]
    Linear(#[from] LinearError),
}

/// What is evaluated: one kind of robot, one or more models for it.
#[derive(Debug, Clone, Copy)]
pub struct Subject<'a> {
    /// Intake, intervals and alarms of the live path. Its platforms do not count.
    pub settings: &'a FleetSettings,
    /// The kind of robot; `None` takes period and limits from each recording
    /// ([`recorded_platform`]).
    pub platform: Option<&'a Platform>,
    /// The models; the first is the one that the others are compared with.
    pub models: &'a [Model],
    /// The recordings.
    pub recordings: &'a [Recording],
    /// Which rows are evaluated and which the baselines are fitted on.
    pub design: &'a Design,
}

/// What came of an evaluation.
#[derive(Debug, Clone)]
pub struct Scored {
    /// All scores.
    pub report: ScoreReport,
    /// The live path of each model, step by step.
    pub live: Vec<Evaluation>,
    pub(crate) blocks: blocks::Tallied,
}

impl Options {
    fn check(&self) -> Result<(), ScoreError> {
        let mut before = 0;
        for &found in &self.horizons {
            if !(before < found && found <= LONGEST_HORIZON) {
                return Err(ScoreError::Horizon { found, before });
            }
            before = found;
        }
        let Bootstrap {
            confidence,
            block_rows,
            ..
        } = self.bootstrap;
        for (what, found, fine, allowed) in [
            (
                "origins_every",
                self.origins_every as f64,
                self.origins_every > 0,
                "1 row or more",
            ),
            (
                "block_rows",
                block_rows as f64,
                block_rows > 0,
                "1 row or more",
            ),
            (
                "confidence",
                confidence,
                0.0 < confidence && confidence < 1.0,
                "a share above 0 and below 1",
            ),
        ] {
            if !fine {
                return Err(ScoreError::Option {
                    what,
                    found,
                    allowed,
                });
            }
        }
        Ok(())
    }
}

/// Evaluates the models on the recordings, in parallel.
///
/// ```
/// use joulebus_config::{Config, builtin_model};
/// use joulebus_sim::protocol;
/// use joulebus_eval::score::{Design, Options, Recording, Subject, score};
/// use joulebus_predictor::{Model, Network};
///
/// let config = Config::load(concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/fleet.toml"))?;
/// let (_, file) = builtin_model("gternal-sim").ok_or("no such model ships")?;
/// let models = [Model::Network(Network::from_safetensors(file)?)];
/// // Simulated; of a file, `Trial::read` makes one.
/// let trials = [protocol::trial(4, 7)?, protocol::trial(6, 7)?];
/// let recordings: Vec<_> = (0..).zip(trials).map(|(id, trial)| Recording::new(id, trial)).collect();
/// let subject = Subject {
///     settings: config.settings(),
///     platform: None,
///     models: &models,
///     recordings: &recordings,
///     design: &Design::folds(&recordings),
/// };
/// let scored = score(subject, &Options::default())?;
/// println!("{}", scored.report);
/// // The network, persistence and the lines: all on the same rows.
/// let all = &scored.report.all;
/// assert!(all.forecasters.iter().all(|one| one.count == all.rows));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`ScoreError`]: nothing to evaluate, options or settings that are refused.
pub fn score(subject: Subject<'_>, options: &Options) -> Result<Scored, ScoreError> {
    options.check()?;
    let Subject {
        models, recordings, ..
    } = subject;
    if recordings.is_empty() {
        return Err(ScoreError::NoRecording);
    }
    if models.is_empty() {
        return Err(ScoreError::NoModel);
    }
    let lines = fit_lines(subject.design, recordings, &options.baselines)?;
    let all = (0..recordings.len())
        .into_par_iter()
        .map(|at| corrected::one(subject, options, &lines, at))
        .collect::<Result<Vec<_>, _>>()?;
    let (tallied, by_recording): (Vec<_>, Vec<Vec<RobotEvaluation>>) = all.into_iter().unzip();
    let blocks = blocks::Tallied::new(recordings, tallied);
    if blocks.rows() == 0 {
        let rows = recordings.iter().map(|recording| recording.trial.rows());
        return Err(ScoreError::NoRows {
            recordings: recordings.len(),
            rows: rows.sum(),
        });
    }
    let mut live = vec![Evaluation { robots: Vec::new() }; models.len()];
    for robots in by_recording {
        for (evaluation, robot) in live.iter_mut().zip(robots) {
            evaluation.robots.push(robot);
        }
    }
    let report = report::report(subject, options, &lines, &blocks);
    Ok(Scored {
        report,
        live,
        blocks,
    })
}
