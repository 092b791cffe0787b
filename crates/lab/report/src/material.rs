//! Inputs of a report's sections.

use super::figure::{Colour, Figure, Interval};
use joulebus_eval::evaluate::{RobotEvaluation, Series};
use joulebus_eval::score::{ForecasterScore, Recording, Scored};
use joulebus_train::linear::Terms;

use super::unit::Unit;
use joulebus_statistics::bootstrap::Estimate;

/// An evaluation and its recordings.
#[derive(Clone, Copy)]
pub(super) struct Material<'a> {
    pub(super) recordings: &'a [Recording],
    pub(super) scored: &'a Scored,
    pub(super) unit: Unit,
    /// The note in every figure.
    pub(super) note: Option<&'a str>,
    /// True if the robots are simulated GTernals, so that the paper's numbers are shown.
    pub(super) beside_paper: bool,
}

/// The baselines of a report: the steps of the ablation.
pub(super) const BASELINES: [Terms; 4] =
    [Terms::VELOCITIES, Terms::velocities_and_lags(1), Terms::AR5, Terms::AR5_AND_VELOCITIES];

impl<'a> Material<'a> {
    /// Number of models. They are the first forecasters.
    pub(super) fn models(&self) -> usize {
        self.scored.report.models.len()
    }

    /// The forecasters shown in every comparison: the models, persistence, and the linear model
    /// with the network's features.
    pub(super) fn compared(&self) -> Vec<(usize, String)> {
        let forecasters = &self.scored.report.all.forecasters;
        let line = Terms::AR5_AND_VELOCITIES.to_string();
        forecasters
            .iter()
            .enumerate()
            .filter(|(at, score)| *at <= self.models() || score.name == line)
            .map(|(at, score)| (at, score.name.clone()))
            .collect()
    }

    /// The forecasters in tables: those compared, the references, and the members of the models'
    /// online forecasts.
    pub(super) fn listed(&self) -> Vec<usize> {
        let forecasters = &self.scored.report.all.forecasters;
        let lines = self.models() + BASELINES.len();
        let compared = self.compared().into_iter().map(|(at, _)| at);
        compared.chain(lines + 1..forecasters.len()).collect()
    }

    /// The colour of a forecaster, the same in every figure.
    pub(super) fn colour(&self, forecaster: usize) -> Colour {
        match forecaster.checked_sub(self.models()) {
            None if forecaster == 0 => Colour::Blue,
            None => Colour::Purple,
            Some(0) => Colour::Orange,
            Some(past) if past == BASELINES.len() => Colour::Green,
            Some(_) => Colour::Sky,
        }
    }

    /// Name of the first model.
    pub(super) fn model(&self) -> &'a str {
        let models = self.scored.report.models.first();
        models.map_or("model", |model| model.name.as_str())
    }

    /// Results of the first model's live path.
    pub(super) fn live(&self) -> &'a [RobotEvaluation] {
        self.scored.live.first().map_or(&[], |live| live.robots.as_slice())
    }

    /// The time series of the trial of this name.
    pub(super) fn series(&self, name: &str) -> Option<Series> {
        let mut robots = self.live().iter();
        let robot = robots.find(|robot| robot.path.display().to_string() == name)?;
        Some(Series::new(robot))
    }

    /// Adds the note to a figure.
    pub(super) fn noted(&self, mut figure: Figure) -> Figure {
        figure.note = self.note.map(str::to_owned);
        figure
    }
}

/// The file name of a trial without folder and extension, and the robot's number where the file has
/// several. In the published layout robots are numbers.
pub(super) fn label(name: &str) -> String {
    let is_number = |text: &str| text.parse::<u32>().is_ok();
    if is_number(name) {
        return format!("robot {name}");
    }
    let (name, robot) = match name.rsplit_once(' ') {
        Some((name, robot)) if is_number(robot) => (name, Some(robot)),
        _ => (name, None),
    };
    let file = name.rsplit('/').next().unwrap_or(name);
    let stem = file.split('.').next().unwrap_or(file);
    let stem = stem.strip_prefix("energy_data_").unwrap_or(stem);
    let stem = if stem.is_empty() { name } else { stem }.replace('_', " ");
    robot.map_or_else(|| stem.clone(), |robot| format!("{stem} robot {robot}"))
}

pub(super) fn interval(estimate: Estimate) -> Interval {
    Interval { value: estimate.value, low: estimate.lo, high: estimate.hi }
}

pub(super) fn scaled(estimate: Estimate, scale: impl Fn(f64) -> f64) -> Interval {
    Interval { value: scale(estimate.value), low: scale(estimate.lo), high: scale(estimate.hi) }
}

/// Skill against persistence. NaN for persistence itself.
pub(super) fn skill_against_persistence(score: &ForecasterScore) -> Estimate {
    let against = score.skill.iter().find(|skill| skill.against == "persistence");
    against.map_or(Estimate::alone(f64::NAN), |skill| skill.skill)
}
