//! The report of `joulebus eval`: the live path, and the scores of each platform.

use std::fmt;

use serde::Serialize;

use crate::evaluate::{Evaluation, EvaluationReport, LivePool};
use crate::score::{Reported, ScoreReport};

/// Maximum number of trials whose live scores are listed. Of more, one line per platform.
const MAX_LISTED: usize = 24;

/// The live path's scores, and the evaluation of each platform. `Display` is text.
#[derive(Debug, Clone, Serialize)]
pub struct EvalReport {
    #[serde(flatten)]
    live: EvaluationReport,
    /// One for each platform.
    pub evaluations: Vec<ScoreReport>,
}

impl EvalReport {
    /// Creates the report from the live path of all trials and the scores of each platform.
    pub fn new(live: &Evaluation, evaluations: Vec<ScoreReport>) -> Self {
        Self { live: live.report(), evaluations }
    }

    /// The same of each platform's evaluation.
    pub fn of_reported(reported: Vec<Reported>) -> Self {
        let (mut live, mut evaluations) = (LivePool::default(), Vec::new());
        for one in reported {
            one.live.into_iter().for_each(|pool| live.append(pool));
            evaluations.push(one.report);
        }
        Self { live: live.report(), evaluations }
    }
}

impl fmt::Display for EvalReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (at, evaluation) in self.evaluations.iter().enumerate() {
            if at > 0 {
                writeln!(out, "\n")?;
            }
            write!(out, "{evaluation}")?;
        }
        writeln!(out, "\nLive path: the readings of these rows, and those after gaps")?;
        if self.live.robots.len() <= MAX_LISTED {
            return write!(out, "{}", self.live);
        }
        let platforms = EvaluationReport { robots: Vec::new(), ..self.live.clone() };
        write!(out, "{platforms}")
    }
}
