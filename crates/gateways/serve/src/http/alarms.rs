//! Alarms that are raised, and their newest changes.

use std::collections::VecDeque;
use std::sync::Arc;

use joulebus_board::AcknowledgedRecord;
use joulebus_consumer::{AlarmHistory, FleetAlarm, SourceAlarms};
use joulebus_wire::{Acknowledgement, AlarmCard};
use serde::Serialize;

/// Maximum number of raises and ends of alarms that are kept.
const MAX_CHANGES: usize = 200;

#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(super) struct RaisedRecord {
    robot: u32,
    alarm: &'static str,
    since_unix_ns: u64,
    /// Null if nobody has.
    acknowledged: Option<AcknowledgedRecord>,
}

/// A raise, an acknowledgement or an end of an alarm.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(super) struct ChangeRecord {
    robot: u32,
    alarm: &'static str,
    /// raised, acknowledged, cleared, or left: the robot is not in the fleet any more.
    change: &'static str,
    at_unix_ns: u64,
    raised_unix_ns: u64,
    /// Null if nobody had acknowledged it.
    acknowledged: Option<AcknowledgedRecord>,
}

impl RaisedRecord {
    pub(super) fn is(&self, card: &AlarmCard) -> bool {
        self.alarm == card.name
    }
}

/// Alarms as clients get them.
#[derive(Debug, Clone, Default, Serialize)]
pub(super) struct Alarms {
    pub(super) raised: Vec<RaisedRecord>,
    pub(super) changes: VecDeque<ChangeRecord>,
    /// Number of changes so far, those no longer kept included.
    #[serde(skip)]
    pub(super) number: u64,
}

/// Keeps them up to date.
#[derive(Debug, Default)]
pub(super) struct AlarmLog {
    newest: Arc<Alarms>,
    added: Vec<FleetAlarm>,
}

impl AlarmLog {
    /// Adds a change. [`AlarmLog::update`] then publishes it.
    pub(super) fn add(&mut self, change: FleetAlarm) {
        self.added.push(change);
    }

    /// Publishes the added changes. `unix_of` converts monotonic times to Unix time, ns.
    pub(super) fn update(
        &mut self,
        (history, sources): (&AlarmHistory, &SourceAlarms),
        unix_of: impl Fn(u64) -> u64,
    ) {
        if self.added.is_empty() {
            return;
        }
        let mut alarms = Alarms::clone(&self.newest);
        let acknowledged = |row: &Acknowledgement| AcknowledgedRecord::new(row, &unix_of);
        for change in self.added.drain(..) {
            // Those of the worker have no robot, and are shown as its state.
            let Some(robot) = change.robot else { continue };
            alarms.number += 1;
            alarms.changes.push_front(ChangeRecord {
                robot,
                alarm: change.alarm,
                change: change.change.name(),
                at_unix_ns: unix_of(change.at_ns),
                raised_unix_ns: unix_of(change.raised_ns),
                acknowledged: change.acknowledged.as_ref().map(acknowledged),
            });
            alarms.changes.truncate(MAX_CHANGES);
        }
        let raised = history.raised().map(|(robot, alarm, since_ns)| RaisedRecord {
            robot,
            alarm: alarm.name(),
            since_unix_ns: unix_of(since_ns),
            acknowledged: history.acknowledged(robot, alarm).map(acknowledged),
        });
        let of_sources = sources.raised().map(|(robot, since_ns)| RaisedRecord {
            robot,
            alarm: AlarmCard::IMPLAUSIBLE.name,
            since_unix_ns: unix_of(since_ns),
            acknowledged: None,
        });
        alarms.raised = raised.chain(of_sources).collect();
        self.newest = Arc::new(alarms);
    }

    /// The alarms as clients get them.
    pub(super) fn newest(&self) -> Arc<Alarms> {
        Arc::clone(&self.newest)
    }
}

#[cfg(test)]
mod tests {
    use joulebus_wire::Alarm;

    /// The order of alarms in `page/alarms.js`.
    #[test]
    fn the_page_knows_the_level_of_each_alarm() {
        let page = include_str!("../../page/alarms.js");
        let (_, table) = page.split_once("const LEVELS = {").unwrap_or_default();
        let (table, _) = table.split_once("};").unwrap_or_default();
        let entries: Vec<(&str, &str)> = table
            .split(',')
            .filter_map(|entry| entry.split_once(':'))
            .map(|(alarm, level)| (alarm.trim(), level.trim().trim_matches('"')))
            .collect();
        assert!(!entries.is_empty(), "{page}");
        for alarm in Alarm::ALL {
            let found = entries.iter().find(|(name, _)| *name == alarm.name());
            let level = found.map_or("warn", |(_, level)| level);
            assert_eq!(level, alarm.level().name(), "{}", alarm.name());
        }
        let is_known = |name: &str| Alarm::ALL.iter().any(|alarm| alarm.name() == name);
        for (name, _) in entries {
            assert!(is_known(name), "{name} is no alarm");
        }
    }

    #[test]
    fn the_page_offers_the_new_normal_of_each_alarm_that_can_have_one() {
        let named: Vec<&str> =
            Alarm::ALL.into_iter().filter(|alarm| alarm.is_of_level()).map(Alarm::name).collect();
        let line = format!("const OF_LEVEL = {};", serde_json::json!(named)).replace(',', ", ");
        let page = include_str!("../../page/card.js");
        assert!(page.contains(&line), "the page needs {line}");
    }
}
