//! Tables: the scores of a set of recordings, each forecaster on the same rows.

use std::io;

use serde::Serialize;

use super::Options;
use super::blocks::{Block, Draws};
use super::tallied::{ConstantInterval, Set, Tallied};
use joulebus_statistics::bootstrap::Estimate;
use joulebus_statistics::metrics::{Coverage, CoverageTally, ResidualQuantiles};

/// Scores of a set of recordings in corrected mode: all of them, a group, a robot or a trial. Their
/// rows are pooled: R² is about the mean over all of them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Cell {
    /// `all`, or the name of the group, robot or trial.
    pub name: String,
    /// Trials.
    pub trials: usize,
    /// Rows scored, for every forecaster.
    pub rows: u64,
    /// Rows left out because a model has no forecast for them.
    pub unscored: u64,
    /// Mean of the readings, W.
    pub reading_mean_w: f64,
    /// Standard deviation of the readings, W.
    pub reading_std_w: f64,
    /// Resampled blocks of the confidence intervals.
    pub blocks: Blocks,
    /// The models, persistence, the linear baselines, the references, the members of the models'
    /// online forecasts.
    pub forecasters: Vec<ForecasterScore>,
}

/// Resampled blocks of confidence intervals.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Blocks {
    /// Number of blocks. Below [`joulebus_statistics::bootstrap::MIN_BLOCKS`], there is no
    /// interval.
    pub count: usize,
    /// True if each block is a whole trial. Otherwise a number of consecutive rows.
    pub whole_trials: bool,
}

/// One forecaster. Undefined scores are NaN, null in JSON. Definitions:
/// [`Tally`](joulebus_statistics::metrics::Tally).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ForecasterScore {
    /// Its name.
    pub name: String,
    /// Its role in this evaluation.
    pub role: Role,
    /// Rows scored. They are fewer than the cell's if a linear baseline lacks a feature.
    pub count: u64,
    /// Coefficient of determination.
    pub r2: Estimate,
    /// Root of the mean squared residual, W.
    pub rmse_w: Estimate,
    /// Mean absolute residual, W.
    pub mae_w: Estimate,
    /// Mean absolute relative residual, share.
    pub mape: f64,
    /// Mean of reading minus forecast, W.
    pub bias_w: Estimate,
    /// Quantiles of reading minus forecast, W.
    pub residual: ResidualQuantiles,
    /// (Forecast energy − measured energy) / measured energy, share.
    pub energy_error: Estimate,
    /// Against persistence, and against each linear baseline.
    pub skill: Vec<Skill>,
    /// The constant interval about its forecasts that would have held the middle 90 %
    /// of these readings, known afterwards: what intervals are to be compared with.
    pub hindsight: ConstantInterval,
    /// The intervals of the live path, or those of another program.
    pub interval: Option<IntervalScore>,
}

/// The role of a forecaster in an evaluation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// The forecast that a model's platform publishes.
    Published,
    /// Persistence, a linear model fitted on the recordings, or a reference.
    Baseline,
    /// A member of a published forecast that learns online.
    Member,
}

/// 1 − ratio of the mean squared error to a baseline's. Positive is better.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Skill {
    /// The baseline.
    pub against: String,
    /// The skill.
    #[serde(flatten)]
    pub skill: Estimate,
}

/// Coverage and width of the live intervals.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct IntervalScore {
    /// Counts, shares and width.
    #[serde(flatten)]
    pub scores: Coverage,
    /// Share inside, with its confidence interval.
    pub inside: Estimate,
    /// Mean width, W, with its confidence interval.
    pub width: Estimate,
    /// Mean interval score, W ([`Coverage::score_w`]), with its confidence interval.
    pub score: Estimate,
    /// Mean pinball loss of both ends, W.
    pub pinball_w: f64,
    /// Weighted interval score of forecast and interval, W: the continuous ranked probability score
    /// as far as both give it (Bracher and others, "Evaluating epidemic forecasts in an interval
    /// format", 2021).
    pub wis_w: f64,
}

impl IntervalScore {
    fn new(scores: Coverage, mae_w: f64, [inside, width, score]: [Estimate; 3]) -> Self {
        let outside = 1.0 - scores.nominal;
        Self {
            scores,
            inside,
            width,
            score,
            pinball_w: outside / 4.0 * scores.score_w,
            wis_w: (mae_w / 2.0 + outside / 2.0 * scores.score_w) / 1.5,
        }
    }
}

/// Names of the forecasters, and which of them are models and which baselines. The others are
/// members.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Names {
    pub(crate) forecasters: Vec<String>,
    pub(crate) models: usize,
    /// Persistence, the linear baselines, and the references.
    pub(crate) baselines: usize,
    /// Forecasters with intervals.
    pub(crate) intervals: Vec<usize>,
    /// Nominal coverage of the live intervals.
    pub(crate) nominal: f64,
}

impl Names {
    /// Forecasters used as references: the baselines.
    fn references(&self) -> std::ops::Range<usize> {
        self.models..self.models + self.baselines
    }

    fn against(&self, of: usize) -> impl Iterator<Item = usize> + use<> {
        self.references().filter(move |reference| *reference != of)
    }

    /// The interval of a forecaster.
    fn interval<'a>(&self, block: &'a Block, of: usize) -> Option<&'a CoverageTally> {
        let place = self.intervals.iter().position(|with| *with == of)?;
        block.intervals.get(place)
    }

    fn role(&self, forecaster: usize) -> Role {
        if forecaster < self.models {
            Role::Published
        } else if self.references().contains(&forecaster) {
            Role::Baseline
        } else {
            Role::Member
        }
    }

    fn skills(&self, of: usize, estimates: &mut impl Iterator<Item = Estimate>) -> Vec<Skill> {
        let against = self.against(of);
        let named = against.map(|reference| self.forecasters[reference].clone());
        named.zip(estimates).map(|(against, skill)| Skill { against, skill }).collect()
    }
}

/// Scores of each forecaster that have confidence intervals, in the order in which [`cell`] reads
/// them.
fn statistics(block: &Block, names: &Names) -> Vec<f64> {
    let mut found = Vec::with_capacity(16 * block.forecasters.len());
    for (at, tally) in block.forecasters.iter().enumerate() {
        found.extend([
            tally.r2(),
            tally.rmse_w(),
            tally.mae_w(),
            tally.bias_w(),
            tally.energy_error(),
        ]);
        let skill = |reference: usize| tally.skill(&block.forecasters[reference]);
        found.extend(names.against(at).map(skill));
        if let Some(interval) = names.interval(block, at) {
            found.extend([
                interval.coverage(),
                interval.width_w(),
                interval.score_w(names.nominal),
            ]);
        }
    }
    found
}

/// The table of a set of recordings.
///
/// # Errors
/// Residuals cannot be read from their temporary file.
pub(crate) fn cell(
    tallied: &Tallied,
    set: &Set,
    names: &Names,
    options: &Options,
) -> io::Result<Cell> {
    let (blocks, whole_trials) = tallied.blocks(set, &options.bootstrap);
    let whole = Block::merged(&blocks);
    let draws = Draws::new(&blocks);
    let statistics = |drawn: &[usize]| statistics(&draws.merged(drawn), names);
    let estimates = options.bootstrap.estimate(blocks.len(), statistics);
    let mut estimates = estimates.into_iter();
    let forecasters = whole.forecasters.iter().enumerate().map(|(at, tally)| {
        // There are as many estimates as statistics.
        let mut next = || estimates.next().unwrap_or(Estimate::alone(f64::NAN));
        let [r2, rmse_w, mae_w, bias_w, energy_error] = std::array::from_fn(|_| next());
        let skill = names.skills(at, &mut std::iter::from_fn(|| Some(next())));
        let interval = names.interval(&whole, at).map(|interval| {
            let estimates = std::array::from_fn(|_| next());
            IntervalScore::new(interval.coverage_of(names.nominal), mae_w.value, estimates)
        });
        let (residual, hindsight) = tallied.residuals(set, at)?;
        Ok(ForecasterScore {
            name: names.forecasters[at].clone(),
            role: names.role(at),
            count: tally.count(),
            r2,
            rmse_w,
            mae_w,
            mape: tally.mape(),
            bias_w,
            residual,
            energy_error,
            skill,
            hindsight,
            interval,
        })
    });
    let forecasters = forecasters.collect::<io::Result<_>>()?;
    let first = whole.forecasters.first().copied().unwrap_or_default();
    Ok(Cell {
        name: set.name.clone(),
        trials: set.trials(),
        rows: first.count(),
        unscored: first.unscored(),
        reading_mean_w: first.reading_mean_w(),
        reading_std_w: first.reading_std_w(),
        blocks: Blocks { count: blocks.len(), whole_trials },
        forecasters,
    })
}
