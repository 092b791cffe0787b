//! Alerts of Alertmanager's API v2: the state of every alarm, sent when it changes and again as
//! long as it is raised.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use joulebus_board::AlarmRecord;
use joulebus_wire::AlarmCard;
use serde_json::{Value, json};

use super::body::{link, of, rfc3339};

/// A raised alert ends at Alertmanager after so many times the interval of repeats, unless it is
/// sent again. Prometheus does the same.
const LASTS_REPEATS: u32 = 4;

/// Robot and alarm. No robot: the worker.
pub(super) type AlertKey = (Option<u32>, &'static str);

/// The alarms that are raised, and those whose end has not been sent.
#[derive(Debug)]
pub(super) struct Alerts {
    fleet: String,
    page: Option<String>,
    repeat: Duration,
    alerts: BTreeMap<AlertKey, Alert>,
}

#[derive(Debug)]
struct Alert {
    started_ns: u64,
    ended_ns: Option<u64>,
    acknowledged: Option<String>,
    /// Changes that no request has delivered, and those of them that the last one contained.
    changes: u64,
    sent: u64,
    due: Instant,
}

impl Alerts {
    pub(super) const fn new(fleet: String, page: Option<String>, repeat: Duration) -> Self {
        Self { fleet, page, repeat, alerts: BTreeMap::new() }
    }

    /// Takes a change of an alarm that was raised at `raised_ns`, Unix time.
    pub(super) fn take(&mut self, change: &AlarmRecord, raised_ns: u64, now: Instant) {
        let new = Alert {
            started_ns: raised_ns,
            ended_ns: None,
            acknowledged: None,
            changes: 0,
            sent: 0,
            due: now,
        };
        let alert = self.alerts.entry((change.robot, change.alarm)).or_insert(new);
        alert.started_ns = raised_ns;
        alert.ended_ns = change.lasted_s.map(|_| change.stamp_ns);
        alert.acknowledged = change.acknowledged.as_ref().map(|row| row.by.clone());
        alert.changes += 1;
        alert.due = now;
    }

    /// Alerts to send now, at most as many.
    pub(super) fn due(&self, now: Instant, most: usize) -> Vec<AlertKey> {
        let due = self.alerts.iter().filter(|(_, alert)| alert.due <= now);
        due.map(|(key, _)| *key).take(most).collect()
    }

    /// The body of a request with these alerts, as they are at `now_ns`, Unix time.
    pub(super) fn body(&mut self, keys: &[AlertKey], now_ns: u64) -> Value {
        let lasts_ns = (self.repeat * LASTS_REPEATS).as_nanos() as u64;
        let Self { fleet, page, alerts, .. } = self;
        let body = keys.iter().filter_map(|key| {
            let alert = alerts.get_mut(key)?;
            alert.sent = alert.changes;
            Some(alert.body(*key, fleet, page.as_deref(), now_ns + lasts_ns))
        });
        body.collect()
    }

    /// Notes that the receiver has taken or refused the last body. Returns the changes in it.
    pub(super) fn settle(&mut self, keys: &[AlertKey], now: Instant) -> u64 {
        let mut settled = 0;
        for key in keys {
            let Some(alert) = self.alerts.get_mut(key) else { continue };
            settled += alert.sent;
            alert.changes -= alert.sent;
            // One that has changed meanwhile is still due.
            if alert.changes == 0 {
                alert.due = now + self.repeat;
                if alert.ended_ns.is_some() {
                    self.alerts.remove(key);
                }
            }
        }
        settled
    }
}

impl Alert {
    fn body(&self, (robot, alarm): AlertKey, fleet: &str, page: Option<&str>, ends: u64) -> Value {
        let mut labels = json!({ "alertname": alarm, "fleet": fleet });
        let summary = format!("{alarm} of {} of fleet {fleet}", of(robot));
        let mut annotations = json!({ "summary": summary });
        if let Some(robot) = robot {
            labels["robot"] = json!(robot.to_string());
        }
        if let Some(card) = AlarmCard::named(alarm) {
            labels["severity"] = json!(match card.level.name() {
                "error" => "critical",
                "ok" => "info",
                _ => "warning",
            });
            annotations["description"] = json!(card.meaning);
            annotations["check"] = json!(card.check);
        }
        if let Some(by) = &self.acknowledged {
            annotations["acknowledged_by"] = json!(by);
        }
        let mut alert = json!({
            "labels": labels,
            "annotations": annotations,
            "startsAt": rfc3339(self.started_ns),
            "endsAt": rfc3339(self.ended_ns.unwrap_or(ends)),
        });
        if let Some(page) = page {
            alert["generatorURL"] = json!(link(page, robot));
        }
        alert
    }
}

#[cfg(test)]
mod tests {
    use super::super::body::tests::raised;
    use super::*;

    const REPEAT: Duration = Duration::from_secs(60);
    const START_NS: u64 = 1_764_000_000_000_000_000;

    fn cleared() -> AlarmRecord {
        let stamp_ns = START_NS + 5_000_000_000;
        AlarmRecord { stamp_ns, change: "cleared", lasted_s: Some(5.0), ..raised("StuckSensor") }
    }

    fn alerts() -> Alerts {
        Alerts::new("lab".to_owned(), Some("http://page".to_owned()), REPEAT)
    }

    #[test]
    fn an_alert_has_labels_that_stay_and_annotations_from_the_card() {
        let (mut alerts, now) = (alerts(), Instant::now());
        alerts.take(&raised("StuckSensor"), START_NS, now);
        let keys = alerts.due(now, 9);
        let raise = alerts.body(&keys, START_NS)[0].clone();
        assert_eq!(raise["endsAt"], "2025-11-24T16:04:00.000Z", "four repeats later");
        alerts.take(&cleared(), START_NS, now);
        let end = alerts.body(&keys, START_NS)[0].clone();
        assert_eq!(end["endsAt"], "2025-11-24T16:00:05.000Z");
        assert_eq!(raise["labels"], end["labels"], "they identify the alert");
        let labels = json!({
            "alertname": "StuckSensor", "fleet": "lab", "robot": "7", "severity": "critical",
        });
        assert_eq!(raise["labels"], labels);
        assert_eq!(raise["startsAt"], "2025-11-24T16:00:00.000Z");
        assert_eq!(raise["annotations"]["summary"], "StuckSensor of robot 7 of fleet lab");
        let card = AlarmCard::named("StuckSensor").unwrap();
        assert_eq!(raise["annotations"]["description"], card.meaning);
        assert_eq!(raise["annotations"]["check"], card.check);
        assert_eq!(raise["generatorURL"], "http://page/?robot=7");
    }

    #[test]
    fn a_raised_alert_is_repeated_and_an_end_is_sent_once() {
        let (mut alerts, now) = (alerts(), Instant::now());
        alerts.take(&raised("StuckSensor"), START_NS, now);
        let keys = alerts.due(now, 9);
        alerts.body(&keys, START_NS);
        assert_eq!(alerts.settle(&keys, now), 1);
        assert_eq!(alerts.due(now + REPEAT / 2, 9), []);
        assert_eq!(alerts.due(now + REPEAT, 9), keys);
        alerts.body(&keys, START_NS);
        assert_eq!(alerts.settle(&keys, now), 0, "a repeat is no change");
        alerts.take(&cleared(), START_NS, now);
        alerts.body(&alerts.due(now, 9), START_NS);
        assert_eq!(alerts.settle(&keys, now), 1);
        assert_eq!(alerts.due(now + REPEAT * 9, 9), []);
    }

    #[test]
    fn a_change_during_a_request_is_sent_with_the_next() {
        let (mut alerts, now) = (alerts(), Instant::now());
        alerts.take(&raised("StuckSensor"), START_NS, now);
        let keys = alerts.due(now, 9);
        alerts.body(&keys, START_NS);
        alerts.take(&cleared(), START_NS, now);
        assert_eq!(alerts.settle(&keys, now), 1);
        assert_eq!(alerts.due(now, 9), keys);
    }
}
