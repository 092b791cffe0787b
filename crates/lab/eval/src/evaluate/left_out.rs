//! Samples of a trial that the tick refused, and those without a forecast.

use std::collections::BTreeMap;
use std::fmt;

use joulebus_wire::Quality;
use serde::Serialize;

use super::RobotEvaluation;

/// Samples of a trial that were refused or got no forecast, for one reason.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LeftOut {
    /// Id of the robot.
    pub robot: u32,
    /// The trial's file.
    pub file: String,
    /// Number of samples.
    pub samples: u64,
    /// `dropped` or `without forecast`, and the reason.
    pub why: String,
}

impl fmt::Display for LeftOut {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { robot, file, samples, why } = self;
        write!(out, "robot {robot} of {file}: {samples} samples {why}")
    }
}

impl RobotEvaluation {
    /// Samples that were refused or got no forecast, by reason.
    pub fn left_out(&self) -> Vec<LeftOut> {
        let mut whys: BTreeMap<String, u64> = BTreeMap::new();
        for step in self.steps.iter().filter(|step| step.accepted) {
            if let Quality::Invalid(reason) = step.quality {
                *whys.entry(format!("without forecast: {}", reason.name())).or_default() += 1;
            }
        }
        let drops = self.drops.iter().filter(|(_, count)| *count > 0);
        whys.extend(drops.map(|(reason, count)| (format!("dropped: {}", reason.name()), count)));
        let file = self.path.display().to_string();
        let left_out = whys.into_iter().map(|(why, samples)| LeftOut {
            robot: self.robot,
            file: file.clone(),
            samples,
            why,
        });
        left_out.collect()
    }
}
