//! An evaluation as a table and as JSON.

use std::collections::BTreeMap;
use std::fmt;

use joulebus_fleet::{Learned, Scores};
use joulebus_wire::Quality;
use serde::Serialize;

use super::{Evaluation, Forecast, RobotEvaluation};

/// An evaluation without its steps. `Display` is a table. Unknown numbers are null in JSON.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EvaluationReport {
    /// One entry per platform and model, sorted by name.
    pub platforms: Vec<PlatformReport>,
    /// One entry per trial, in order.
    pub robots: Vec<RobotReport>,
}

/// Scores of the forecasts and of persistence.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ScoreReport {
    /// Readings scored.
    pub scored: u64,
    /// Mean absolute residual, W.
    pub mae_w: f64,
    /// Coefficient of determination.
    pub r2: f64,
    /// Mean absolute error of persistence on the same readings, W.
    pub persistence_mae_w: f64,
    /// Coefficient of determination of persistence.
    pub persistence_r2: f64,
    /// 1 − ratio of the squared error to persistence's. Positive is better than persistence.
    pub skill: f64,
}

/// All trials of a platform, their readings pooled: R² is against the mean over all of them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlatformReport {
    /// Name of the platform.
    pub platform: String,
    /// Name of the model.
    pub model: String,
    /// The origin of the scored forecasts. `None` without a trial.
    pub forecast: Option<Forecast>,
    /// Trials.
    pub trials: usize,
    /// Samples accepted.
    pub accepted: u64,
    /// Samples dropped.
    pub dropped: u64,
    /// The pooled scores.
    #[serde(flatten)]
    pub scores: ScoreReport,
}

/// One trial.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RobotReport {
    /// Id of the robot.
    pub robot: u32,
    /// The trial's file.
    pub file: String,
    /// Name of the platform.
    pub platform: String,
    /// Name of the model.
    pub model: String,
    /// The origin of the scored forecasts.
    pub forecast: Forecast,
    /// Quality notes, in one line.
    pub notes: String,
    /// Samples accepted.
    pub accepted: u64,
    /// Samples dropped, by reason.
    pub dropped: BTreeMap<String, u64>,
    /// Samples by the quality of their forecast.
    pub qualities: BTreeMap<String, u64>,
    /// The scores.
    #[serde(flatten)]
    pub scores: ScoreReport,
    /// Share of scored readings inside their interval.
    pub coverage: f32,
    /// State of online learning after the trial, if the platform learns online.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub learned: Option<Learned>,
    /// Energy drawn over the metered time, J.
    pub drawn_j: f64,
    /// Metered time, s.
    pub metered_s: f64,
    /// Unmetered time, s.
    pub unmetered_s: f64,
}

impl Evaluation {
    /// The evaluation without its steps.
    pub fn report(&self) -> EvaluationReport {
        let mut pool = LivePool::default();
        let robots = self.robots.iter();
        robots.for_each(|robot| pool.push(robot.into()));
        pool.report()
    }
}

/// Trials of one or several platforms, without their readings: these are pooled as they come.
#[derive(Debug, Clone, Default)]
pub(crate) struct LivePool {
    /// Totals by platform and model.
    platforms: BTreeMap<(String, String), Pooled>,
    robots: Vec<RobotReport>,
}

/// The trials of a platform and model.
#[derive(Debug, Clone)]
struct Pooled {
    forecast: Forecast,
    trials: usize,
    accepted: u64,
    dropped: u64,
    /// Scores of the readings of all trials, in order.
    scores: Scores,
}

impl LivePool {
    /// Adds the next trial.
    pub(crate) fn push(&mut self, LiveTrial { report, scored_readings_w }: LiveTrial) {
        let key = (report.platform.clone(), report.model.clone());
        let pooled = self.platforms.entry(key).or_insert_with(|| Pooled {
            forecast: report.forecast,
            trials: 0,
            accepted: 0,
            dropped: 0,
            scores: Scores::default(),
        });
        pooled.trials += 1;
        pooled.accepted += report.accepted;
        pooled.dropped += report.dropped.values().sum::<u64>();
        for [reading_w, residual_w, previous_w] in scored_readings_w {
            pooled.scores.observe(reading_w, residual_w, previous_w);
        }
        self.robots.push(report);
    }

    /// Adds trials of other platforms or models.
    pub(crate) fn append(&mut self, other: Self) {
        self.platforms.extend(other.platforms);
        self.robots.extend(other.robots);
    }

    pub(crate) fn report(self) -> EvaluationReport {
        let platforms = self.platforms.into_iter();
        EvaluationReport {
            platforms: platforms.map(platform_report).collect(),
            robots: self.robots,
        }
    }
}

fn platform_report(((platform, model), pooled): ((String, String), Pooled)) -> PlatformReport {
    PlatformReport {
        platform,
        model,
        forecast: Some(pooled.forecast),
        trials: pooled.trials,
        accepted: pooled.accepted,
        dropped: pooled.dropped,
        scores: (&pooled.scores).into(),
    }
}

/// The live path of a trial without its steps. All trials of a platform are pooled reading by
/// reading, so that the sums do not depend on how many are evaluated at once.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LiveTrial {
    report: RobotReport,
    /// For each scored reading, in order: the reading, the residual of its forecast, and the
    /// previous reading, W.
    scored_readings_w: Vec<[f32; 3]>,
}

impl From<&RobotEvaluation> for LiveTrial {
    fn from(robot: &RobotEvaluation) -> Self {
        let mut qualities = BTreeMap::new();
        for step in &robot.steps {
            *qualities.entry(quality_name(step.quality)).or_default() += 1;
        }
        let drops = robot.drops.iter();
        let report = RobotReport {
            robot: robot.robot,
            file: robot.path.display().to_string(),
            platform: robot.platform.clone(),
            model: robot.model.clone(),
            forecast: robot.forecast,
            notes: robot.notes.to_string(),
            accepted: robot.accepted,
            dropped: drops.map(|(reason, count)| (reason.name().to_owned(), count)).collect(),
            qualities,
            scores: (&robot.scores).into(),
            coverage: robot.coverage,
            learned: robot.learned,
            drawn_j: robot.ledger.drawn_uj as f64 / 1e6,
            metered_s: robot.ledger.metered_ns as f64 / 1e9,
            unmetered_s: robot.ledger.unmetered_ns as f64 / 1e9,
        };
        Self { report, scored_readings_w: robot.scored_readings_w().collect() }
    }
}

fn quality_name(quality: Quality) -> String {
    match quality {
        Quality::Fresh => "Fresh".to_owned(),
        Quality::Held => "Held".to_owned(),
        Quality::Warmup { .. } => "Warmup".to_owned(),
        Quality::OpenLoop { .. } => "OpenLoop".to_owned(),
        Quality::Invalid(reason) => format!("Invalid({})", reason.name()),
        _ => "Unknown".to_owned(),
    }
}

impl From<&Scores> for ScoreReport {
    fn from(scores: &Scores) -> Self {
        Self {
            scored: scores.count,
            mae_w: scores.mae_w(),
            r2: scores.r2(),
            persistence_mae_w: scores.persistence_mae_w(),
            persistence_r2: scores.persistence_r2(),
            skill: scores.skill(),
        }
    }
}

impl fmt::Display for EvaluationReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            out,
            "{:>8}  {:<16} {:<20} {:<11} {SCORE_TITLE}  energy     file",
            "robot", "platform", "model", "forecast"
        )?;
        for robot in &self.robots {
            let scores = ScoreColumns(&robot.scores);
            let RobotReport { robot, file, platform, model, forecast, drawn_j, .. } = robot;
            writeln!(
                out,
                "{robot:>8}  {platform:<16} {model:<20} {forecast:<11} {scores}  {drawn_j:>8.1} J {file}"
            )?;
        }
        for robot in &self.robots {
            let without = robot.qualities.iter();
            for (quality, count) in without.filter(|(name, _)| name.starts_with("Invalid")) {
                writeln!(
                    out,
                    "robot {}: {count} samples without forecast: {quality}",
                    robot.robot
                )?;
            }
            for (reason, count) in &robot.dropped {
                writeln!(out, "robot {}: {count} samples dropped: {reason}", robot.robot)?;
            }
        }
        for platform in &self.platforms {
            let scores = ScoreColumns(&platform.scores);
            let PlatformReport { platform, model, forecast, trials, .. } = platform;
            let forecast = forecast.map(|forecast| forecast.to_string());
            let forecast = forecast.unwrap_or_default();
            writeln!(
                out,
                "{:>8}  {platform:<16} {model:<20} {forecast:<11} {scores}  {trials} trials",
                "all"
            )?;
        }
        Ok(())
    }
}

const SCORE_TITLE: &str = "  scored   MAE W      R²  persistence: MAE W      R²   skill";

struct ScoreColumns<'a>(&'a ScoreReport);

impl fmt::Display for ScoreColumns<'_> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ScoreReport { scored, mae_w, r2, persistence_mae_w, persistence_r2, skill } = self.0;
        write!(
            out,
            "{scored:>8} {mae_w:>7.3} {r2:>7.4} {persistence_mae_w:>19.3} {persistence_r2:>7.4} {skill:>7.4}"
        )
    }
}
