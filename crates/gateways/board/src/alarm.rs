//! A change of an alarm as JSON.

use joulebus_consumer::FleetAlarm;
use serde::Serialize;

/// An alarm change, as `joulebus alarms --format json` and webhooks report it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AlarmRecord {
    /// Name of the fleet.
    pub fleet: String,
    /// Unix time, ns.
    pub stamp_ns: u64,
    /// Null for the worker.
    pub robot: Option<u32>,
    /// Name of the alarm.
    pub alarm: &'static str,
    /// ok, warn, error or stale.
    pub level: &'static str,
    /// raised, cleared, or left: the robot is not in the fleet any more.
    pub change: &'static str,
    /// Time from the raise to the clearance, s. Null for a raise.
    pub lasted_s: Option<f64>,
}

impl AlarmRecord {
    /// The record of a change in `fleet` at `stamp_ns` (Unix time).
    #[must_use]
    pub fn new(fleet: &str, change: &FleetAlarm, stamp_ns: u64) -> Self {
        Self {
            fleet: fleet.to_owned(),
            stamp_ns,
            robot: change.robot,
            alarm: change.alarm,
            level: change.level.name(),
            change: change.change.name(),
            lasted_s: change.lasted_s(),
        }
    }
}
