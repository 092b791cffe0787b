//! Options of scoring.

use joulebus_statistics::bootstrap::Bootstrap;
use joulebus_train::linear::Terms;

use super::Reference;
use super::error::{MAX_HORIZON, ScoreError};

/// Maximum number of draws for confidence intervals.
const MAX_RESAMPLES: u32 = 1_000_000;

/// Options of scoring.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Horizons of the open loop, ticks, ascending, each 1 to [`MAX_HORIZON`]. Empty to disable
    /// it.
    pub horizons: Vec<usize>,
    /// Rows from one origin of the open loop to the next, counted through all recordings, at
    /// least 1. A horizon of fewer ticks has its origins that far apart.
    pub origins_every: usize,
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
    /// Horizons of 1 to 300 ticks in half decades, an origin every 10 rows at most, AR(5) and
    /// AR(5) + velocities.
    fn default() -> Self {
        Self {
            horizons: vec![1, 3, 10, 30, 100, 300],
            origins_every: 10,
            energy: false,
            baselines: vec![Terms::AR5, Terms::AR5_AND_VELOCITIES],
            references: Vec::new(),
            bootstrap: Bootstrap::default(),
        }
    }
}

impl Options {
    pub(super) fn check(&self) -> Result<(), ScoreError> {
        let mut before = 0;
        for &found in &self.horizons {
            if !(before < found && found <= MAX_HORIZON) {
                return Err(ScoreError::Horizon { found, before });
            }
            before = found;
        }
        let Bootstrap { resamples, confidence, block_rows, .. } = self.bootstrap;
        let (rows, every) = (block_rows as f64, self.origins_every as f64);
        let is_share = 0.0 < confidence && confidence < 1.0;
        let few = resamples <= MAX_RESAMPLES;
        for (what, found, fine, allowed) in [
            ("origins_every", every, every > 0.0, "1 row or more"),
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
