//! Recorded trials through the tick, offline, in one pass: to the bit the results of a live run.

mod left_out;
mod series;

use std::collections::HashSet;
use std::fmt;
use std::path::PathBuf;

use joulebus_fleet::{Fleet, Learned, Ledger, Scores};
use joulebus_predictor::Model;
use joulebus_settings::{FleetSettings, Platform, SettingsError};
use joulebus_wire::{
    DropCounts, InvalidReason, Quality, SCHEMA_VERSION, Sample, SampleHeader, diagnostic_flag,
    sample_flag,
};
use serde::Serialize;

pub use left_out::LeftOut;
pub use series::Series;

use joulebus_dataset::trial::{Trial, TrialNotes};

/// Time of every trial's first row. Only differences of time matter, but 0 means "never measured".
const BASE_NS: u64 = 1_000_000_000;

/// Errors of an evaluation.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum EvaluateError {
    #[error("found no trial to evaluate. Name one or more files")]
    NoTrial,
    #[error(
        "robot {robot} belongs to none of the {platforms} platforms. Add its id to one of them"
    )]
    UnknownRobot { robot: u32, platforms: usize },
    #[error("robot {robot} has more than one trial. Give each trial an id of its own")]
    DuplicateRobot { robot: u32 },
    #[error(transparent)]
    Settings(#[from] SettingsError),
}

/// The origin of the forecasts that are published, and so scored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Forecast {
    /// The forecast learned online for each robot from its last reading, the network and the
    /// model's autoregression.
    Online,
    /// The network's own.
    Network,
    /// The last reading.
    Persistence,
}

impl Forecast {
    /// The published forecast of a model's platform. `online` states that it learns online
    /// ([`Platform::online`]).
    pub const fn new(model: &Model, online: bool) -> Self {
        match (model, online) {
            (Model::Persistence(_), _) => Self::Persistence,
            (Model::Network(_), true) => Self::Online,
            (Model::Network(_), false) => Self::Network,
        }
    }
}

impl fmt::Display for Forecast {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.pad(match self {
            Self::Online => "online",
            Self::Network => "network",
            Self::Persistence => "persistence",
        })
    }
}

/// Results of the trials, in their order.
#[derive(Debug, Clone)]
pub struct Evaluation {
    /// One entry per trial.
    pub robots: Vec<RobotEvaluation>,
}

/// Results of one trial.
#[derive(Debug, Clone)]
pub struct RobotEvaluation {
    /// Id of the robot.
    pub robot: u32,
    /// The trial's file.
    pub path: PathBuf,
    /// Quality notes on the trial.
    pub notes: TrialNotes,
    /// Name of the robot's platform.
    pub platform: String,
    /// Name of the model.
    pub model: String,
    /// The origin of these forecasts.
    pub forecast: Forecast,
    /// One entry per sample, in order.
    pub steps: Vec<Step>,
    /// Scores of the forecasts.
    pub scores: Scores,
    /// Share of scored readings inside their interval. NaN before the first.
    pub coverage: f32,
    /// State of online learning after the trial. `None` if the platform does not learn online.
    pub learned: Option<Learned>,
    /// Energy ledger.
    pub ledger: Ledger,
    /// Samples accepted.
    pub accepted: u64,
    /// Samples dropped, by reason.
    pub drops: DropCounts,
}

/// Result of one sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// Number of the sample, equal to its row's number, from 0.
    pub sample_seq: u64,
    /// The sample's stamp relative to the trial's first row, ns.
    pub stamp_ns: u64,
    /// True if the sample was accepted. Otherwise the other fields are empty.
    pub accepted: bool,
    /// The sample's reading, W.
    pub reading_w: Option<f32>,
    /// The reading minus its forecast, W.
    pub residual_w: Option<f32>,
    /// The reading minus the network's forecast of it, W, whatever was published. Same as in the
    /// diagnostics.
    pub network_residual_w: Option<f32>,
    /// True if the residual is scored: its forecast was one step ahead.
    pub scored: bool,
    /// Forecast of the next reading, W.
    pub power_w: Option<f32>,
    /// Lower end of its interval, W.
    pub lo_w: Option<f32>,
    /// Upper end of its interval, W.
    pub hi_w: Option<f32>,
    /// Quality of the forecast, or why there is none.
    pub quality: Quality,
}

/// Runs each trial through the tick, sample by sample, each robot alone.
///
/// Robot ids determine the platform, as in a live run. `models[i]` is the model of
/// `settings.platforms[i]`. A live run of the same trials gives the same forecasts, residuals and
/// scores to the bit, in a mixed fleet and at any speed, because a robot's results depend neither
/// on other robots nor on the worker's clock. Only how its first forecasts start depends on what its
/// platform remembers of other robots: here it is nothing.
///
/// The exception is a gap in which the live robot leaves (`leave_after`). Here it stays up to the
/// longest gap that ingest accepts (`max_jump`), and otherwise leaves at the first sample after the
/// gap, which is refused.
///
/// # Errors
/// [`EvaluateError`]: no trial, a repeated robot, a robot in no platform, or settings that are
/// refused.
pub fn evaluate(
    settings: &FleetSettings,
    models: &[Model],
    trials: &[(u32, Trial)],
) -> Result<Evaluation, EvaluateError> {
    if trials.is_empty() {
        return Err(EvaluateError::NoTrial);
    }
    let mut robots = HashSet::new();
    if let Some((robot, _)) = trials.iter().find(|(robot, _)| !robots.insert(*robot)) {
        return Err(EvaluateError::DuplicateRobot { robot: *robot });
    }
    let robots = trials
        .iter()
        .map(|(robot, trial)| evaluate_trial(settings, models, *robot, trial))
        .collect::<Result<Vec<_>, _>>()?;
    Ok(Evaluation { robots })
}

/// Runs one trial through the tick, as [`evaluate`] does.
///
/// # Errors
/// [`EvaluateError`]: a robot in no platform, or settings that are refused.
pub fn evaluate_trial(
    settings: &FleetSettings,
    models: &[Model],
    robot: u32,
    trial: &Trial,
) -> Result<RobotEvaluation, EvaluateError> {
    let is_its = |platform: &Platform| platform.robots.iter().any(|ids| ids.contains(&robot));
    let kind = settings.platforms.iter().position(is_its);
    let Some(kind) = kind else {
        return Err(EvaluateError::UnknownRobot { robot, platforms: settings.platforms.len() });
    };
    let alone = FleetSettings { capacity: 1, ..settings.clone() };
    let mut fleet = Fleet::new(alone, models.to_vec())?;
    let mut steps = Vec::with_capacity(trial.rows());
    let (mut now_ns, mut published_w, mut has_left) = (0, None, false);
    for sample in trial.samples(robot, BASE_NS) {
        now_ns = sample.stamp_ns.max(now_ns);
        let mut next = step(&mut fleet, &sample, now_ns);
        has_left |= fleet.is_empty();
        if let (true, Some(reading_w), Some(power_w)) = (next.scored, next.reading_w, published_w) {
            next.residual_w = Some(reading_w - power_w);
        }
        if next.accepted {
            published_w = next.power_w;
        }
        steps.push(next);
    }
    let coverage = (!fleet.is_empty()).then(|| fleet.diagnostic(0).coverage);
    let mut found = RobotEvaluation {
        robot,
        path: trial.path().to_owned(),
        notes: trial.notes().clone(),
        platform: settings.platforms[kind].name.clone(),
        model: models[kind].name().to_owned(),
        forecast: Forecast::new(&models[kind], settings.platforms[kind].online),
        steps,
        scores: fleet.scores(robot).unwrap_or_default(),
        coverage: coverage.unwrap_or(f32::NAN),
        learned: fleet.learned(robot),
        ledger: fleet.ledger(robot).unwrap_or_default(),
        accepted: fleet.accepted(),
        drops: fleet.drops(),
    };
    if has_left {
        // The fleet scores a robot from the sample on with which it came back.
        found.score_again();
    }
    Ok(found)
}

/// A tick with one sample.
fn step(fleet: &mut Fleet, sample: &Sample, now_ns: u64) -> Step {
    let header = SampleHeader {
        schema: SCHEMA_VERSION,
        source_id: 1,
        source_epoch: 1,
        frame_seq: sample.seq,
        samples_before: sample.seq,
        intended_ns: now_ns,
        sent_ns: now_ns,
        ..SampleHeader::default()
    };
    let (accepted_before, scored_before) = (fleet.accepted(), scored(fleet, sample.robot));
    fleet.take(&header, std::slice::from_ref(sample), now_ns);
    fleet.tick(now_ns, false);
    let accepted = fleet.accepted() > accepted_before;
    let stamp_ns = sample.stamp_ns.saturating_sub(BASE_NS);
    let reading_w = sample.has(sample_flag::POWER).then_some(sample.power_w);
    // The capacity is 1, and this is the only robot. It leaves if no sample was accepted for too
    // long: after a gap that ingest refuses, or after a long stretch of refused values. The next
    // sample brings it back.
    if fleet.is_empty() {
        return Step::of_nobody(sample.seq, stamp_ns, reading_w);
    }
    let (forecast, diagnostic) = (fleet.forecast(0), fleet.diagnostic(0));
    let known = |value: Option<f32>| value.filter(|_| accepted);
    let interval = forecast.interval_w();
    let has_residual = diagnostic.flags & diagnostic_flag::RESIDUAL != 0;
    Step {
        sample_seq: sample.seq,
        stamp_ns,
        accepted,
        reading_w,
        residual_w: known(has_residual.then_some(diagnostic.residual_w)),
        network_residual_w: known(has_residual.then_some(diagnostic.residual_w)),
        scored: scored(fleet, sample.robot) > scored_before,
        power_w: known(forecast.expected_w()),
        lo_w: known(interval.map(|(lo_w, _)| lo_w)),
        hi_w: known(interval.map(|(_, hi_w)| hi_w)),
        quality: forecast.quality(),
    }
}

impl Step {
    /// The step of a refused sample whose robot is not in the fleet.
    const fn of_nobody(sample_seq: u64, stamp_ns: u64, reading_w: Option<f32>) -> Self {
        Self {
            sample_seq,
            stamp_ns,
            accepted: false,
            reading_w,
            residual_w: None,
            network_residual_w: None,
            scored: false,
            power_w: None,
            lo_w: None,
            hi_w: None,
            quality: Quality::Invalid(InvalidReason::Stale),
        }
    }
}

fn scored(fleet: &Fleet, robot: u32) -> u64 {
    fleet.scores(robot).map_or(0, |scores| scores.count)
}

impl RobotEvaluation {
    /// Sums the scores of the steps that are marked as scored.
    pub(crate) fn score_again(&mut self) {
        let mut scores = Scores::default();
        for [reading_w, residual_w, previous_w] in self.scored_readings_w() {
            scores.observe(reading_w, residual_w, previous_w);
        }
        self.scores = scores;
    }

    /// The scored readings in order: each with the residual of its forecast and the reading before
    /// it, W.
    fn scored_readings_w(&self) -> impl Iterator<Item = [f32; 3]> + '_ {
        let mut previous_w = None;
        let accepted = self.steps.iter().filter(|step| step.accepted);
        accepted.filter_map(move |step| {
            let before_w = std::mem::replace(&mut previous_w, step.reading_w);
            let scored_w = [step.reading_w?, step.residual_w?, before_w?];
            step.scored.then_some(scored_w)
        })
    }
}
