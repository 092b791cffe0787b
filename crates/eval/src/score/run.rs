//! Runs an evaluation.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicUsize, Ordering};

use joulebus_train::linear::Linear;
use rayon::prelude::*;

use super::blocks::{Sums, Tallied};
use super::common::Common;
use super::corrected::{self, Found};
use super::design::fit_lines;
use super::report::{ScoreReport, report};
use super::{Options, ScoreError, Subject};
use crate::energy::EnergyScores;
use crate::evaluate::Evaluation;

/// Result of an evaluation.
#[derive(Debug, Clone)]
pub struct Scored {
    /// All scores.
    pub report: ScoreReport,
    /// The live path of each model, step by step; readings of rows that are not evaluated are not scored.
    pub live: Vec<Evaluation>,
    pub(crate) blocks: Tallied,
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
/// // Simulated; `Trial::read` reads one from a file.
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
/// // The network, persistence and the linear baselines: all on the same rows.
/// let all = &scored.report.all;
/// assert!(all.forecasters.iter().all(|one| one.count == all.rows));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`ScoreError`]: nothing to evaluate, or options or settings that are refused.
pub fn score(subject: Subject<'_>, options: &Options) -> Result<Scored, ScoreError> {
    score_watched(subject, options, |_| ControlFlow::Continue(()))
}

/// As [`score`]. `watch` is called, from any thread, when a recording is done, with the number of those that are; it
/// may end the evaluation.
///
/// # Errors
/// As [`score`]; [`ScoreError::Ended`] when `watch` has ended it.
pub fn score_watched(
    subject: Subject<'_>,
    options: &Options,
    watch: impl Fn(usize) -> ControlFlow<()> + Sync,
) -> Result<Scored, ScoreError> {
    let prepared = Prepared::new(subject, options)?;
    let recordings = prepared.common.recordings.len();
    let mut live = vec![Evaluation { robots: Vec::new() }; subject.models.len()];
    let mut sums = SumsOfAll::default();
    for found in prepared.run(0..recordings, watch)? {
        for (evaluation, robot) in live.iter_mut().zip(found.live) {
            evaluation.robots.push(robot);
        }
        sums.push(found.sums, found.trained_on, found.energy);
    }
    let (report, blocks) = sums.report(&prepared.common)?;
    Ok(Scored {
        report,
        live,
        blocks,
    })
}

/// An evaluation before its recordings are run.
pub(super) struct Prepared<'a> {
    subject: Subject<'a>,
    options: &'a Options,
    lines: Vec<Vec<Option<Linear>>>,
    pub(super) common: Common,
}

impl<'a> Prepared<'a> {
    pub(super) fn new(subject: Subject<'a>, options: &'a Options) -> Result<Self, ScoreError> {
        options.check()?;
        if subject.recordings.is_empty() {
            return Err(ScoreError::NoRecording);
        }
        if subject.models.is_empty() {
            return Err(ScoreError::NoModel);
        }
        let lines = fit_lines(subject.design, subject.recordings, &options.baselines)?;
        Ok(Self {
            subject,
            options,
            common: Common::of(subject, options, &lines),
            lines,
        })
    }

    /// Runs some recordings, in parallel. Results are in the order of `places`.
    pub(super) fn run(
        &self,
        places: impl IntoParallelIterator<Item = usize, Iter: IndexedParallelIterator>,
        watch: impl Fn(usize) -> ControlFlow<()> + Sync,
    ) -> Result<Vec<Found>, ScoreError> {
        let done = AtomicUsize::new(0);
        let each = places.into_par_iter().map(|at| {
            let found = corrected::one(self.subject, self.options, &self.lines, at)?;
            match watch(done.fetch_add(1, Ordering::Relaxed) + 1) {
                ControlFlow::Continue(()) => Ok(found),
                ControlFlow::Break(()) => Err(ScoreError::Ended),
            }
        });
        each.collect()
    }
}

/// The sums of all recordings, in their order.
#[derive(Default)]
pub(super) struct SumsOfAll {
    evaluated: Vec<Sums>,
    trained_on: Vec<Sums>,
    /// Of each model.
    energy: Vec<EnergyScores>,
}

impl SumsOfAll {
    pub(super) fn push(&mut self, evaluated: Sums, trained_on: Sums, energy: Vec<EnergyScores>) {
        self.evaluated.push(evaluated);
        self.trained_on.push(trained_on);
        if self.energy.len() < energy.len() {
            self.energy.resize_with(energy.len(), Default::default);
        }
        for (all, one) in self.energy.iter_mut().zip(energy) {
            all.append(one);
        }
    }

    pub(super) fn report(self, common: &Common) -> Result<(ScoreReport, Tallied), ScoreError> {
        let blocks = Tallied::new(&common.recordings, self.evaluated);
        let apart = Tallied::new(&common.recordings, self.trained_on);
        if blocks.rows() == 0 {
            let rows = common.recordings.iter().map(|recording| recording.rows);
            return Err(ScoreError::NoRows {
                recordings: common.recordings.len(),
                rows: rows.sum(),
            });
        }
        let mut energy = self.energy;
        if common.energy {
            energy.resize_with(common.models.len(), Default::default);
        }
        let report = report(common, [&blocks, &apart], &energy);
        Ok((report, blocks))
    }
}
