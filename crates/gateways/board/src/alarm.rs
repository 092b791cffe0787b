//! A change of an alarm, and what the alarm means, as JSON.

use joulebus_consumer::{Change, FleetAlarm};
use joulebus_wire::{Acknowledgement, AlarmCard};
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
    /// raised, acknowledged, cleared, or left: the robot is not in the fleet any more.
    pub change: &'static str,
    /// Time from the raise to the clearance, s. Null while it is raised.
    pub lasted_s: Option<f64>,
    /// The acknowledgement since it was raised.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub acknowledged: Option<AcknowledgedRecord>,
    /// The meaning and the remedy, for a raise only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub card: Option<CardRecord>,
}

/// An acknowledgement (by whom, when) as JSON.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct AcknowledgedRecord {
    /// The person's name.
    pub by: String,
    /// Unix time, ns.
    pub at_unix_ns: u64,
}

impl AcknowledgedRecord {
    /// Makes it from a row. `unix_of` converts its time to Unix time, ns.
    #[must_use]
    pub fn new(row: &Acknowledgement, unix_of: impl Fn(u64) -> u64) -> Self {
        Self { by: row.by().to_owned(), at_unix_ns: unix_of(row.at_ns) }
    }
}

/// The meaning of an alarm: an [`AlarmCard`] as JSON.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CardRecord {
    /// Name of the alarm.
    pub alarm: &'static str,
    /// ok, warn, error or stale.
    pub level: &'static str,
    /// The condition while it is raised.
    pub meaning: &'static str,
    /// Things to look at, the likeliest cause first.
    pub check: &'static str,
    /// Keys of the configuration that decide when it is raised.
    pub keys: &'static [&'static str],
    /// Time from the cause to the alarm, with the shipped settings.
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
            acknowledged: change.acknowledged.map(|row| {
                let unix_of = |at_ns| stamp_ns.saturating_sub(change.at_ns.saturating_sub(at_ns));
                AcknowledgedRecord::new(&row, unix_of)
            }),
            card: (change.change == Change::Raised)
                .then(|| AlarmCard::named(change.alarm).map(CardRecord::from))
                .flatten(),
        }
    }
}
