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
use crate::evaluate::{Evaluation, LiveTrial, RobotEvaluation};

/// Result of an evaluation.
#[derive(Debug, Clone)]
pub struct Scored {
    /// All scores.
    pub report: ScoreReport,
    /// The live path of each model, step by step; readings of rows that are not evaluated are not scored.
    pub live: Vec<Evaluation>,
}

/// What is reported of an evaluation, without the steps of the live path.
#[derive(Debug, Clone)]
pub struct Reported {
    /// All scores.
    pub report: ScoreReport,
    /// The live path: by model, in the recordings' order.
    pub(crate) live: Vec<LiveTrial>,
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
    let (report, _, live) = run_all(subject, options, watch, Some)?;
    let live = live.into_iter().map(|robots| Evaluation { robots });
    Ok(Scored {
        report,
        live: live.collect(),
    })
}

/// As [`score`], for reports. The steps of a recording's live path, which are most of what [`Scored`] holds, are gone when
/// the recording is done.
///
/// # Errors
/// As [`score`].
pub fn score_reported(subject: Subject<'_>, options: &Options) -> Result<Reported, ScoreError> {
    let watch = |_| ControlFlow::Continue(());
    let keep = |robot| Some(LiveTrial::from(&robot));
    let (report, _, live) = run_all(subject, options, watch, keep)?;
    Ok(Reported {
        report,
        live: live.into_iter().flatten().collect(),
    })
}

/// The tables, and their sums, without the live path.
pub(super) fn tallied(
    subject: Subject<'_>,
    options: &Options,
) -> Result<(ScoreReport, Tallied), ScoreError> {
    let watch = |_| ControlFlow::Continue(());
    let (report, blocks, _) = run_all(subject, options, watch, |_| None::<()>)?;
    Ok((report, blocks))
}

/// The tables, their sums, and what `keep` makes of the live path of each model, in the recordings' order.
fn run_all<T: Send>(
    subject: Subject<'_>,
    options: &Options,
    watch: impl Fn(usize) -> ControlFlow<()> + Sync,
    keep: impl Fn(RobotEvaluation) -> Option<T> + Sync,
) -> Result<(ScoreReport, Tallied, Vec<Vec<T>>), ScoreError> {
    let prepared = Prepared::new(subject, options)?;
    let recordings = prepared.common.recordings.len();
    let mut live: Vec<Vec<T>> = subject.models.iter().map(|_| Vec::new()).collect();
    let mut sums = SumsOfAll::default();
    for found in prepared.run(0..recordings, watch, keep)? {
        for (all, one) in live.iter_mut().zip(found.live) {
            all.extend(one);
        }
        sums.push(found.sums, found.trained_on, found.energy);
    }
    let (report, blocks) = sums.report(&prepared.common)?;
    Ok((report, blocks, live))
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

    /// Runs some recordings, in parallel. Results are in the order of `places`; of the live path they have what `keep`
    /// makes of it as soon as a recording is done.
    pub(super) fn run<T: Send>(
        &self,
        places: impl IntoParallelIterator<Item = usize, Iter: IndexedParallelIterator>,
        watch: impl Fn(usize) -> ControlFlow<()> + Sync,
        keep: impl Fn(RobotEvaluation) -> T + Sync,
    ) -> Result<Vec<Found<T>>, ScoreError> {
        let done = AtomicUsize::new(0);
        let each = places.into_par_iter().map(|at| {
            let found = corrected::one(self.subject, self.options, &self.lines, at)?;
            let found = found.keeping(&keep);
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
