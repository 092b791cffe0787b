//! Runs an evaluation.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use super::blocks::Tallied;
use super::design::fit_lines;
use super::report::{ScoreReport, report};
use super::{Options, ScoreError, Subject, corrected};
use crate::evaluate::{Evaluation, RobotEvaluation};

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
    let done = AtomicUsize::new(0);
    let all = (0..recordings.len())
        .into_par_iter()
        .map(|at| {
            let found = corrected::one(subject, options, &lines, at)?;
            match watch(done.fetch_add(1, Ordering::Relaxed) + 1) {
                ControlFlow::Continue(()) => Ok(found),
                ControlFlow::Break(()) => Err(ScoreError::Ended),
            }
        })
        .collect::<Result<Vec<_>, _>>()?;
    let (mut evaluated, mut apart) = (Vec::new(), Vec::new());
    let mut by_recording: Vec<Vec<RobotEvaluation>> = Vec::new();
    for found in all {
        evaluated.push(found.sums);
        apart.push(found.trained_on);
        by_recording.push(found.live);
    }
    let blocks = Tallied::new(recordings, evaluated);
    let apart = Tallied::new(recordings, apart);
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
    let report = report(subject, options, &lines, [&blocks, &apart]);
    Ok(Scored {
        report,
        live,
        blocks,
    })
}
