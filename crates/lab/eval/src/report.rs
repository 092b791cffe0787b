//! The report of `joulebus eval`.

use std::fmt;

use serde::Serialize;

use crate::score::ScoreReport;

/// The evaluation of each platform. `Display` is text.
#[derive(Debug, Clone, Serialize)]
pub struct EvalReport {
    /// One for each platform.
    pub evaluations: Vec<ScoreReport>,
}

impl fmt::Display for EvalReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (at, evaluation) in self.evaluations.iter().enumerate() {
            if at > 0 {
                writeln!(out, "\n")?;
            }
            write!(out, "{evaluation}")?;
        }
        Ok(())
    }
}
