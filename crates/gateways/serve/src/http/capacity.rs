//! The capacities that were learned of a robot's batteries, from the ledger that the worker saves.

use joulebus_config::Config;
use joulebus_predictor_worker::{LearnedCapacity, learned_capacities};
use serde::Serialize;

/// The last capacity of each month in which one was learned, the oldest first.
#[derive(Debug, Serialize)]
pub(super) struct CapacityRecord {
    robot: u32,
    /// Empty if nothing was learned, or the worker's ledger is not this user's.
    months: Vec<LearnedCapacity>,
}

impl CapacityRecord {
    /// Reads the ledger.
    pub(super) fn read(config: &Config, robot: u32) -> Self {
        let months = learned_capacities(config).remove(&robot).unwrap_or_default();
        Self { robot, months }
    }
}
