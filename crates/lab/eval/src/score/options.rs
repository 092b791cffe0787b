//! Options of scoring.

use joulebus_statistics::bootstrap::Bootstrap;
use joulebus_train::linear::Terms;

use super::Reference;
use super::error::ScoreError;

/// Maximum number of draws for confidence intervals.
const MAX_RESAMPLES: u32 = 1_000_000;

/// Options of scoring.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// True if the energy of the next 1 to 300 s is scored too: rollouts of that length take a
    /// while.
    pub energy: bool,
    /// Linear models as baselines in addition to persistence.
    pub baselines: Vec<Terms>,
    /// Further forecasters to compare with, one tick ahead.
    pub references: Vec<Reference>,
    /// The confidence intervals.
    pub bootstrap: Bootstrap,
}

impl Default for Options {
    /// AR(5) and AR(5) + velocities.
    fn default() -> Self {
        Self {
            energy: false,
            baselines: vec![Terms::AR5, Terms::AR5_AND_VELOCITIES],
            references: Vec::new(),
            bootstrap: Bootstrap::default(),
        }
    }
}

impl Options {
    pub(super) fn check(&self) -> Result<(), ScoreError> {
        let Bootstrap { resamples, confidence, block_rows, .. } = self.bootstrap;
        let rows = block_rows as f64;
        let is_share = 0.0 < confidence && confidence < 1.0;
        let few = resamples <= MAX_RESAMPLES;
        for (what, found, fine, allowed) in [
            ("resamples", resamples.into(), few, "0 to 1,000,000"),
            ("block_rows", rows, rows > 0.0, "1 row or more"),
            ("confidence", confidence, is_share, "above 0 and below 1"),
        ] {
            if !fine {
                return Err(ScoreError::Option { what, found, allowed });
            }
        }
        Ok(())
    }
}
