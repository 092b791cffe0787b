//! A change of an alarm, and what the alarm means, as JSON.

use joulebus_consumer::{Change, FleetAlarm};
use joulebus_wire::AlarmCard;
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
    /// What it means and what to do. Only of a raise.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub card: Option<CardRecord>,
}

/// What an alarm means: an [`AlarmCard`] as JSON.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CardRecord {
    /// Name of the alarm.
    pub alarm: &'static str,
    /// ok, warn, error or stale.
    pub level: &'static str,
    /// What is the case while it is raised.
    pub meaning: &'static str,
    /// What to look at.
    pub check: &'static str,
    /// Keys of the configuration that decide when it is raised.
    pub keys: &'static [&'static str],
    /// How soon it is raised after its cause, with the shipped settings.
    pub found_within: &'static str,
}

impl From<&AlarmCard> for CardRecord {
    fn from(card: &AlarmCard) -> Self {
        Self {
            alarm: card.name,
            level: card.level.name(),
            meaning: card.meaning,
            check: card.check,
            keys: card.keys,
            found_within: card.found_within,
        }
    }
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
            card: (change.change == Change::Raised)
                .then(|| AlarmCard::named(change.alarm).map(CardRecord::from))
                .flatten(),
        }
    }
}
