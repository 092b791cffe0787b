//! Two models on the same rows: the differences, and whether they are significant.

use std::fmt;

use rayon::prelude::*;
use serde::Serialize;

use super::blocks::{Block, Draws};
use super::cell::Role;
use super::common::ModelReport;
use super::design::DesignReport;
use super::run::tallied;
use super::tallied::{Set, Tallied};
use super::trained_on::ScoredRows;
use super::{Options, ScoreError, Subject};
use joulebus_statistics::bootstrap::{Bootstrap, Estimate};

/// Fewest trials from which a comparison tells anything. Rows of one trial share its floor and load,
/// so that one trial is one observation, however long it is.
pub const FEWEST_TRIALS: usize = 10;

/// Index of the two models among the forecasters.
const OLD: usize = 0;
const NEW: usize = 1;

/// Comparison of two models. Every difference is new minus old.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// Name of the platform. `recorded` where period and limits are the recordings'.
    pub platform: String,
    /// The old model.
    pub old: ModelReport,
    /// The new model.
    pub new: ModelReport,
    /// Relation of the compared rows to the models' training.
    pub scored_rows: ScoredRows,
    /// Rows of these tables that are not recognised, in pieces too short, or that change too
    /// rarely, to be recognised as trained on.
    pub untold_rows: usize,
    /// Warnings for the reader of the scores.
    pub warnings: Vec<String>,
    /// The rows that were compared.
    pub design: DesignReport,
    /// Configuration of the confidence intervals. Both models share the draws.
    pub bootstrap: Bootstrap,
    /// All recordings.
    pub all: Difference,
    /// Persistence, and the members of both models' online forecasts, on the rows of `all`.
    pub members: Vec<MemberScore>,
    /// Differences by group. Empty if there is only one.
    pub groups: Vec<Difference>,
    /// Differences by robot. Empty if there is only one.
    pub robots: Vec<Difference>,
    /// Differences by trial. Empty if there is only one.
    pub trials: Vec<Difference>,
}

/// A member of a published forecast, on all recordings.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MemberScore {
    /// Its name.
    pub name: String,
    /// Coefficient of determination.
    pub r2: f64,
    /// Mean absolute residual, W.
    pub mae_w: f64,
}

/// The two models on some recordings, corrected mode.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Difference {
    /// `all`, or the name of the group, robot or trial.
    pub name: String,
    /// Trials.
    pub trials: usize,
    /// Rows for which both models have a forecast.
    pub rows: u64,
    /// Rows for which a model has none.
    pub unscored: u64,
    /// Scores of the old model.
    pub old: Side,
    /// Scores of the new model.
    pub new: Side,
    /// Difference of R².
    pub r2: Estimate,
    /// Difference of the mean absolute residuals, W. Negative if the new model is better.
    pub mae_w: Estimate,
    /// Difference of the root mean squared residuals, W. Negative if the new model is better.
    pub rmse_w: Estimate,
    /// 1 − ratio of the new model's mean squared error to the old one's. Positive if the new model
    /// is better.
    pub skill: Estimate,
    /// Difference of the coverage of the live intervals.
    pub coverage: Estimate,
    /// Verdict by the confidence interval of the skill.
    pub verdict: Verdict,
}

/// Scores of one of the two models.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Side {
    /// Coefficient of determination.
    pub r2: f64,
    /// Root of the mean squared residual, W.
    pub rmse_w: f64,
    /// Mean absolute residual, W.
    pub mae_w: f64,
    /// Mean residual, W.
    pub bias_w: f64,
    /// Share of readings inside the live intervals.
    pub coverage: f64,
    /// Their mean width, W.
    pub width_w: f64,
    /// Skill against persistence.
    pub skill_persistence: f64,
}

/// Verdict: whether the confidence interval of the new model's skill against the old one excludes
/// 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The interval is above 0.
    Better,
    /// The interval is below 0.
    Worse,
    /// The interval includes 0, or there is none, because there is no error to compare.
    Undecided,
    /// There are fewer than [`FEWEST_TRIALS`] trials.
    CannotTell,
}

impl fmt::Display for Verdict {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.pad(match self {
            Self::Better => "better",
            Self::Worse => "worse",
            Self::Undecided => "undecided",
            Self::CannotTell => "cannot tell",
        })
    }
}

impl Verdict {
    fn new(skill: &Estimate, trials: usize) -> Self {
        if trials < FEWEST_TRIALS {
            Self::CannotTell
        } else if skill.is_above(0.0) {
            Self::Better
        } else if skill.is_below(0.0) {
            Self::Worse
        } else {
            Self::Undecided
        }
    }
}

/// Evaluates the two models of the subject, the old one first, on the same rows, and compares them.
/// Its linear baselines are ignored.
///
/// # Errors
/// [`ScoreError`], as [`score`](super::score).
///
/// # Panics
/// If the subject has not exactly two models.
pub fn compare(subject: Subject<'_>, options: &Options) -> Result<Comparison, ScoreError> {
    assert!(subject.models.len() == 2, "{} models, two are compared", subject.models.len());
    let options = Options { baselines: Vec::new(), references: Vec::new(), ..options.clone() };
    let (report, blocks) = tallied(subject, &options)?;
    let differences = |sets: Vec<Set>| -> Vec<Difference> {
        let sets = if sets.len() > 1 { sets } else { Vec::new() };
        let each = sets.par_iter();
        each.map(|set| difference(&blocks, set, &options.bootstrap)).collect()
    };
    // Two models were scored, so there are two reports.
    let [old, new] = [OLD, NEW].map(|at| report.models[at].clone());
    let beside = report.all.forecasters.iter();
    let beside = beside.filter(|one| one.role != Role::Published);
    Ok(Comparison {
        members: beside
            .map(|one| MemberScore {
                name: one.name.clone(),
                r2: one.r2.value,
                mae_w: one.mae_w.value,
            })
            .collect(),
        platform: report.platform,
        old,
        new,
        scored_rows: report.scored_rows,
        untold_rows: report.untold_rows,
        warnings: report.warnings,
        design: report.design,
        bootstrap: options.bootstrap,
        all: difference(&blocks, &blocks.all(), &options.bootstrap),
        groups: differences(blocks.groups()),
        robots: differences(blocks.robots()),
        trials: differences(blocks.trials()),
    })
}

fn difference(tallied: &Tallied, set: &Set, bootstrap: &Bootstrap) -> Difference {
    let blocks = tallied.whole_trials(set);
    let draws = Draws::new(&blocks);
    let estimates = of_trials(bootstrap, blocks.len(), |drawn| {
        let Block { forecasters, intervals } = draws.merged(drawn);
        let (old, new) = (&forecasters[OLD], &forecasters[NEW]);
        vec![
            new.r2() - old.r2(),
            new.mae_w() - old.mae_w(),
            new.rmse_w() - old.rmse_w(),
            new.skill(old),
            intervals[NEW].coverage() - intervals[OLD].coverage(),
        ]
    });
    let whole = Block::merged(&blocks);
    let side = |at: usize| {
        let (tally, interval) = (&whole.forecasters[at], &whole.intervals[at]);
        Side {
            r2: tally.r2(),
            rmse_w: tally.rmse_w(),
            mae_w: tally.mae_w(),
            bias_w: tally.bias_w(),
            coverage: interval.coverage(),
            width_w: interval.width_w(),
            skill_persistence: tally.skill(&whole.forecasters[NEW + 1]),
        }
    };
    Difference {
        name: set.name.clone(),
        trials: set.trials(),
        rows: whole.forecasters[OLD].count(),
        unscored: whole.forecasters[OLD].unscored(),
        old: side(OLD),
        new: side(NEW),
        r2: estimates[0],
        mae_w: estimates[1],
        rmse_w: estimates[2],
        skill: estimates[3],
        coverage: estimates[4],
        verdict: Verdict::new(&estimates[3], blocks.len()),
    }
}

/// Scores with intervals from draws of whole trials, if there are enough.
fn of_trials<S>(bootstrap: &Bootstrap, trials: usize, statistics: S) -> Vec<Estimate>
where
    S: Fn(&[usize]) -> Vec<f64> + Sync,
{
    let resamples = if trials < FEWEST_TRIALS { 0 } else { bootstrap.resamples };
    let estimates = Bootstrap { resamples, ..*bootstrap }.estimate(trials, statistics);
    estimates.into_iter().map(|estimate| estimate.widened_for(trials)).collect()
}
