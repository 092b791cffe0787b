//! Runs an evaluation.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicUsize, Ordering};

use joulebus_train::linear::Linear;

use super::blocks::Sums;
use super::common::Common;
use super::corrected::{self, Found, PlatformsBefore, platforms_before};
use super::design::{fit_lines, fit_references};
use super::references::Learned;
use super::report::{ScoreReport, report};
use super::tallied::{Listed, Tallied};
use super::{Options, Recording, ScoreError, Subject, each};
use crate::energy::EnergyScores;
use crate::evaluate::{Evaluation, LeftOut, RobotEvaluation};

/// Result of an evaluation.
#[derive(Debug, Clone)]
pub struct Scored {
    /// All scores.
    pub report: ScoreReport,
    /// The live path of each model, step by step. Readings of rows that are not evaluated are not
    /// scored.
    pub live: Vec<Evaluation>,
}

/// Evaluates the models on the recordings, in parallel.
///
/// ```
/// use joulebus_config::{Config, builtin_model};
/// use joulebus_sim::protocol;
/// use joulebus_eval::score::{Design, Options, Recording, Subject, score};
/// use joulebus_predictor::{Model, Network};
///
/// let config = Config::load(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../configs/fleet.toml"))?;
/// let (_, file) = builtin_model("gternal-sim").ok_or("no such model ships")?;
/// let models = [Model::Network(Network::from_safetensors(file)?)];
/// // Simulated; `Trial::read` reads one from a file.
/// let trials = [protocol::trial(4, 7)?, protocol::trial(6, 7)?];
/// let recordings = (0..).zip(trials).map(|(id, trial)| Recording::new(id, trial));
/// let recordings: Vec<_> = recordings.collect();
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

/// Same as [`score`]. Calls `watch`, from any thread, after each recording with the number of
/// finished ones. `watch` may end the evaluation.
///
/// # Errors
/// Same as [`score`], and [`ScoreError::Ended`] if `watch` has ended it.
pub fn score_watched(
    subject: Subject<'_>,
    options: &Options,
    watch: impl Fn(usize) -> ControlFlow<()> + Sync,
) -> Result<Scored, ScoreError> {
    let mut live = vec![Evaluation { robots: Vec::new() }; subject.models.len()];
    let take = |model: usize, robot| live[model].robots.push(robot);
    let (report, _) = run_all(subject, options, watch, |robot| robot, take)?;
    Ok(Scored { report, live })
}

/// The tables alone. The steps of a recording's live path, which are most of the contents of
/// [`Scored`], are gone when the recording is done.
///
/// # Errors
/// Same as [`score`].
pub fn score_reported(subject: Subject<'_>, options: &Options) -> Result<ScoreReport, ScoreError> {
    tallied(subject, options).map(|(report, _)| report)
}

/// The tables, and their sums, without the live path.
pub(super) fn tallied(
    subject: Subject<'_>,
    options: &Options,
) -> Result<(ScoreReport, Tallied), ScoreError> {
    let watch = |_| ControlFlow::Continue(());
    run_all(subject, options, watch, |_| (), |_, ()| ())
}

/// The tables and their sums. `take` gets the results of `keep` for the live path of each model,
/// with its index, in the recordings' order.
fn run_all<T: Send>(
    subject: Subject<'_>,
    options: &Options,
    watch: impl Fn(usize) -> ControlFlow<()> + Sync,
    keep: impl Fn(RobotEvaluation) -> T + Sync,
    mut take: impl FnMut(usize, T),
) -> Result<(ScoreReport, Tallied), ScoreError> {
    let prepared = Prepared::new(subject, options)?;
    let mut sums = SumsOfAll::default();
    prepared.run(watch, keep, |at, found| {
        let live = found.live.into_iter().enumerate();
        live.for_each(|(model, kept)| take(model, kept));
        let listed = &prepared.common.recordings[at];
        sums.left_out.extend(found.left_out);
        sums.push(listed, found.sums, found.trained_on, found.energy)
    })?;
    sums.report(prepared.common, options)
}

/// An evaluation before its recordings are run.
struct Prepared<'a> {
    subject: Subject<'a>,
    options: &'a Options,
    lines: Vec<Vec<Option<Linear>>>,
    learned: Vec<Vec<Learned>>,
    platforms: Vec<PlatformsBefore>,
    common: Common,
}

impl<'a> Prepared<'a> {
    fn new(subject: Subject<'a>, options: &'a Options) -> Result<Self, ScoreError> {
        options.check()?;
        if subject.recordings.is_empty() {
            return Err(ScoreError::NoRecording);
        }
        if subject.models.is_empty() {
            return Err(ScoreError::NoModel);
        }
        let lines = fit_lines(subject.design, subject.recordings, &options.baselines)?;
        let learned = fit_references(subject.design, subject.recordings, &options.references)?;
        let common = Common::new(subject, options, &lines)?;
        let platforms = match options.energy {
            true => platforms_before(subject)?,
            false => Vec::new(),
        };
        Ok(Self { subject, options, common, lines, learned, platforms })
    }

    /// Runs the recordings in parallel. `take` gets their indices and results in order. Of the live
    /// path only the result of `keep` is retained when a recording is done.
    fn run<T: Send>(
        &self,
        watch: impl Fn(usize) -> ControlFlow<()> + Sync,
        keep: impl Fn(RobotEvaluation) -> T + Sync,
        take: impl FnMut(usize, Found<T>) -> Result<(), ScoreError>,
    ) -> Result<(), ScoreError> {
        let done = AtomicUsize::new(0);
        let recordings: Vec<&Recording> = self.subject.recordings.iter().collect();
        let one = |at: usize| {
            let found = corrected::one(
                self.subject,
                self.options,
                (&self.lines, &self.learned, &self.platforms),
                at,
                &keep,
            )?;
            match watch(done.fetch_add(1, Ordering::Relaxed) + 1) {
                ControlFlow::Continue(()) => Ok(found),
                ControlFlow::Break(()) => Err(ScoreError::Ended),
            }
        };
        each(&recordings, one, take)
    }
}

/// The sums of all recordings, in their order.
#[derive(Default)]
struct SumsOfAll {
    evaluated: Tallied,
    trained_on: Tallied,
    /// Energy scores of each model.
    energy: Vec<EnergyScores>,
    left_out: Vec<LeftOut>,
}

impl SumsOfAll {
    fn push(
        &mut self,
        listed: &Listed,
        evaluated: Sums,
        trained_on: Sums,
        energy: Vec<EnergyScores>,
    ) -> Result<(), ScoreError> {
        for (all, one) in [(&mut self.evaluated, evaluated), (&mut self.trained_on, trained_on)] {
            all.push(listed, one).map_err(|error| ScoreError::kept(&error))?;
        }
        if self.energy.len() < energy.len() {
            self.energy.resize_with(energy.len(), Default::default);
        }
        for (all, one) in self.energy.iter_mut().zip(energy) {
            all.append(one);
        }
        Ok(())
    }

    fn report(
        self,
        common: Common,
        options: &Options,
    ) -> Result<(ScoreReport, Tallied), ScoreError> {
        if self.evaluated.rows() == 0 {
            let rows = common.recordings.iter().map(|recording| recording.rows);
            return Err(ScoreError::NoRows {
                recordings: common.recordings.len(),
                rows: rows.sum(),
            });
        }
        let mut energy = self.energy;
        if options.energy {
            energy.resize_with(common.models.len(), Default::default);
        }
        let report = report(common, options, [&self.evaluated, &self.trained_on], &energy);
        let mut report = report.map_err(|error| ScoreError::kept(&error))?;
        report.left_out = self.left_out;
        Ok((report, self.evaluated))
    }
}
