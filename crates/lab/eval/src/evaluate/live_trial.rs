//! The parts of a trial's live path that a report needs, without its steps.

use std::collections::BTreeMap;

use joulebus_fleet::{Learned, Scores};
use joulebus_wire::Quality;

use super::{Forecast, RobotEvaluation};

/// The live path of a trial without its steps. All trials of a platform are pooled reading by
/// reading, so that the sums have the same bits in one process and of several.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LiveTrial {
    pub(super) robot: u32,
    pub(super) file: String,
    pub(super) platform: String,
    pub(super) model: String,
    pub(super) forecast: Forecast,
    pub(super) notes: String,
    pub(super) accepted: u64,
    pub(super) dropped: BTreeMap<String, u64>,
    pub(super) qualities: BTreeMap<String, u64>,
    pub(super) scores: Scores,
    pub(super) coverage: f32,
    pub(super) learned: Option<Learned>,
    pub(super) drawn_uj: i64,
    pub(super) metered_ns: u64,
    pub(super) unmetered_ns: u64,
    /// For each scored reading, in order: the reading, the residual of its forecast, and the
    /// previous reading, W.
    pub(super) scored_readings_w: Vec<[f32; 3]>,
}

impl From<&RobotEvaluation> for LiveTrial {
    fn from(robot: &RobotEvaluation) -> Self {
        let mut qualities = BTreeMap::new();
        for step in &robot.steps {
            *qualities.entry(quality_name(step.quality)).or_default() += 1;
        }
        let drops = robot.drops.iter();
        Self {
            robot: robot.robot,
            file: robot.path.display().to_string(),
            platform: robot.platform.clone(),
            model: robot.model.clone(),
            forecast: robot.forecast,
            notes: robot.notes.to_string(),
            accepted: robot.accepted,
            dropped: drops.map(|(reason, count)| (reason.name().to_owned(), count)).collect(),
            qualities,
            scores: robot.scores,
            coverage: robot.coverage,
            learned: robot.learned,
            drawn_uj: robot.ledger.drawn_uj,
            metered_ns: robot.ledger.metered_ns,
            unmetered_ns: robot.ledger.unmetered_ns,
            scored_readings_w: robot.scored_readings_w().collect(),
        }
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
