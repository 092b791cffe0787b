//! The sink of a broker: documents of robots, some retained, and every alarm change.

use std::collections::{BTreeSet, HashMap, VecDeque};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError};
use std::time::Duration;

use joulebus_board::{AlarmRecord, Board};
use joulebus_bus::Rounds;
use joulebus_consumer::{FleetAlarm, FleetAlarms};
use mqtt5_protocol::QoS;
use serde_json::{Value, json};

use crate::config::Write;
use crate::mapping::outgoing::{Object, What, document, values};
use crate::mapping::robots::Robots;
use crate::mqtt::outlet::{Outgoing, Outlet};
use crate::outbound::{Sink, Times, next_due_ns};
use crate::shared::Shared;

/// Maximum number of alarm changes that wait for a connection. Beyond it the oldest are lost.
pub(crate) const MAX_WAITING: usize = 10_000;

/// Number of its intervals after which a broker drops what is written again and again.
const EXPIRES_AFTER: u64 = 3;

/// A topic with the state of its robots.
struct Topic {
    write: Write,
    due_ns: u64,
    /// The last document of each robot, for topics that publish only changes.
    published: HashMap<u32, Value>,
    /// Robots whose document the broker retains.
    kept: BTreeSet<u32>,
}

/// Publishes to the topics of a broker.
pub(crate) struct MqttSink {
    start: Start,
    topics: Vec<Topic>,
    waiting: VecDeque<AlarmRecord>,
    /// Number of topics to which the first waiting change was published.
    published_to: usize,
    /// Changes handed to the connection lately, with the monotonic time, ns. If the connection
    /// breaks, they may not have arrived.
    handed: VecDeque<(u64, AlarmRecord)>,
    connections: u64,
}

/// What a [`MqttSink`] is made with.
pub(crate) struct Start {
    pub(crate) fleet: String,
    pub(crate) name: String,
    pub(crate) robots: Robots,
    pub(crate) writes: Vec<Write>,
    pub(crate) outlet: Arc<Outlet>,
    pub(crate) changes: Receiver<FleetAlarm>,
    pub(crate) shared: Arc<Shared>,
    pub(crate) lost: Arc<AtomicU64>,
    /// Time after which a message has arrived or the connection is known to be broken, ns.
    pub(crate) arrives_within_ns: u64,
}

impl Sink for MqttSink {
    fn publish(&mut self, board: &Board, times: Times) {
        self.take_changes(times);
        if self.start.outlet.is_connected() {
            self.publish_due(board, times);
        }
    }

    fn finish(&mut self) {
        let mut count = self.waiting.len();
        if !self.start.outlet.is_connected() {
            // They may not have arrived, and are not sent again.
            count += self.handed.len();
        }
        self.start.lost.fetch_add(count as u64, Ordering::Relaxed);
    }
}

impl MqttSink {
    pub(crate) fn new(mut start: Start) -> Self {
        let topic = |write: Write| Topic {
            due_ns: 0,
            published: HashMap::new(),
            // The broker may retain documents of an earlier run.
            kept: start.robots.iter().map(|(robot, _)| robot).filter(|_| write.retain).collect(),
            write,
        };
        Self {
            topics: std::mem::take(&mut start.writes).into_iter().map(topic).collect(),
            start,
            waiting: VecDeque::new(),
            published_to: 0,
            handed: VecDeque::new(),
            connections: 0,
        }
    }

    fn take_changes(&mut self, times: Times) {
        for change in self.start.changes.try_iter() {
            if self.waiting.len() >= MAX_WAITING {
                self.waiting.pop_front();
                self.published_to = 0;
                self.start.lost.fetch_add(1, Ordering::Relaxed);
            }
            let record = AlarmRecord::new(&self.start.fleet, &change, times.unix_ns(change.at_ns));
            self.waiting.push_back(record);
        }
    }

    fn publish_due(&mut self, board: &Board, times: Times) {
        let connections = self.start.outlet.connections();
        if connections != self.connections {
            // This is another broker, or one that has lost its retained documents: publish
            // everything again.
            self.connections = connections;
            for topic in &mut self.topics {
                topic.due_ns = 0;
                topic.published.clear();
                if topic.write.retain {
                    // The broker may also have missed the end of a retained document.
                    topic.kept = self.start.robots.iter().map(|(robot, _)| robot).collect();
                }
            }
            while let Some((_, record)) = self.handed.pop_back() {
                self.waiting.push_front(record);
            }
            self.published_to = 0;
        }
        for place in 0..self.topics.len() {
            match self.topics[place].write.what {
                What::AlarmChanges => {}
                _ if times.now_ns < self.topics[place].due_ns => {}
                What::Status => self.publish_status(place, board, times),
                _ => self.publish_robots(place, board, times),
            }
        }
        self.publish_changes(times.now_ns);
    }

    fn publish_changes(&mut self, now_ns: u64) {
        let since_ns = now_ns.saturating_sub(self.start.arrives_within_ns);
        while self.handed.front().is_some_and(|(at_ns, _)| *at_ns < since_ns) {
            self.handed.pop_front();
        }
        let topics = self.topics.iter().filter(|topic| topic.write.what == What::AlarmChanges);
        let topics: Vec<&Topic> = topics.collect();
        while let Some(record) = self.waiting.front() {
            let name = record.robot.and_then(|robot| self.start.robots.name(robot));
            let mut document = json!(record);
            document["name"] = json!(name);
            let payload = document.to_string().into_bytes();
            for topic in &topics[self.published_to.min(topics.len())..] {
                // Retried later, from this topic on.
                if !self.start.outlet.write(topic.write.message("", payload.clone())) {
                    return;
                }
                self.published_to += 1;
            }
            self.published_to = 0;
            let record = self.waiting.pop_front();
            self.handed.extend(record.map(|record| (now_ns, record)));
        }
    }

    fn publish_status(&mut self, place: usize, board: &Board, times: Times) {
        let topic = &mut self.topics[place];
        let unmapped = self.start.shared.account().records();
        let implausible = self.start.shared.intake().judgement().records();
        let status = json!({
            "fleet": self.start.fleet,
            "bridge": self.start.name,
            "state": "online",
            "at_unix_ns": times.now_unix_ns,
            "worker": board.link.name(),
            "messages": self.start.shared.messages(),
            "unmapped": unmapped,
            "implausible": implausible,
        });
        let status = status.to_string().into_bytes();
        if self.start.outlet.write(topic.write.message("", status)) {
            topic.due_ns = next_due_ns(topic.due_ns, topic.write.every_ns, times.now_ns);
        }
    }

    fn publish_robots(&mut self, place: usize, board: &Board, times: Times) {
        let topic = &mut self.topics[place];
        topic.due_ns = next_due_ns(topic.due_ns, topic.write.every_ns, times.now_ns);
        // Without a worker there are no values. The status topic reports that.
        if !board.is_reliable {
            return;
        }
        let mut left = topic.kept.clone();
        for (robot, row) in &board.rows {
            let Some(name) = self.start.robots.name(*robot) else {
                continue;
            };
            left.remove(robot);
            let outlook = board.outlooks.get(robot);
            let unix_ns = |at_ns| times.unix_ns(at_ns);
            let values = values((*robot, name), &row.newest(), outlook, unix_ns);
            topic.publish(*robot, name, &values, &self.start.outlet);
        }
        for robot in left {
            // An empty message deletes a retained document.
            let name = self.start.robots.name(robot).unwrap_or_default();
            let message = Outgoing {
                qos: QoS::AtLeastOnce,
                retain: true,
                ..topic.write.message(name, Vec::new())
            };
            if self.start.outlet.write(message) {
                topic.kept.remove(&robot);
                topic.published.remove(&robot);
            }
        }
    }
}

impl Write {
    /// A message about the robot `name`. What is written again is not to be read later.
    fn message(&self, name: &str, payload: Vec<u8>) -> Outgoing {
        let is_renewed = !matches!(self.what, What::Alarms | What::AlarmChanges);
        let expires_ns = EXPIRES_AFTER.saturating_mul(self.every_ns);
        Outgoing {
            topic: self.topic.of(name),
            payload,
            qos: match self.what {
                What::Forecast | What::Outlook => QoS::AtMostOnce,
                _ => QoS::AtLeastOnce,
            },
            retain: self.retain,
            // An interval is at most an hour.
            expires_s: is_renewed.then(|| expires_ns.div_ceil(1_000_000_000) as u32),
        }
    }
}

impl Topic {
    fn publish(&mut self, robot: u32, name: &str, values: &Object, outlet: &Outlet) {
        let document = document(self.write.what, values);
        let only_changes = self.write.what == What::Alarms;
        if only_changes && self.published.get(&robot) == Some(&document) {
            return;
        }
        let payload = document.to_string().into_bytes();
        let is_handed = outlet.write(self.write.message(name, payload));
        if !is_handed && !only_changes && outlet.is_connected() {
            // The next document replaces this one, so it is not retried.
            outlet.count_lost();
        }
        if is_handed {
            if only_changes {
                self.published.insert(robot, document);
            }
            if self.write.retain {
                self.kept.insert(robot);
            }
        }
    }
}

/// State of the thread that passes every alarm change to the sink.
pub(crate) struct AlarmReading {
    pub(crate) alarms: FleetAlarms,
    pub(crate) to: SyncSender<FleetAlarm>,
    pub(crate) lost: Arc<AtomicU64>,
}

impl Rounds<(), anyhow::Error> for AlarmReading {
    fn round(&mut self) -> anyhow::Result<Duration> {
        self.alarms.wait(|change| {
            if let Err(TrySendError::Full(_)) = self.to.try_send(change) {
                self.lost.fetch_add(1, Ordering::Relaxed);
            }
        })?;
        Ok(Duration::ZERO)
    }

    fn finish(self) -> anyhow::Result<()> {
        self.lost.fetch_add(self.alarms.history().ticks_missed(), Ordering::Relaxed);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::sync_channel;

    use joulebus_consumer::Change;
    use joulebus_consumer::wire::AlarmCard;

    use super::*;
    use joulebus_plausibility::Expired;

    use crate::mapping::intake::{Holds, Intake};
    use crate::mapping::topic::Template;

    const HOLDS: Holds =
        Holds { command_ns: 1, expired: Expired::Unknown, reading_ns: 1, silent_ns: 1 };

    fn write(what: What, topic: &str) -> Write {
        Write {
            what,
            topic: Template::parse(topic, "lab", what.is_of_robot()).unwrap(),
            every_ns: 1,
            retain: false,
        }
    }

    #[test]
    fn a_full_queue_loses_no_change_of_an_alarm_and_publishes_none_twice() {
        // Nothing takes messages from this queue.
        let outlet = Arc::new(Outlet::new(3).unwrap());
        outlet.connected();
        let (changes, changed) = sync_channel(MAX_WAITING);
        for at_ns in 0..2 {
            let card = AlarmCard::named("NoData").unwrap();
            changes.send(FleetAlarm::new(Some(1), card, Change::Raised, at_ns)).unwrap();
        }
        let mut sink = MqttSink::new(Start {
            fleet: "lab".to_owned(),
            name: "bridge".to_owned(),
            robots: Robots::default(),
            writes: vec![
                write(What::AlarmChanges, "one"),
                write(What::AlarmChanges, "other"),
                write(What::Status, "status"),
            ],
            outlet: Arc::clone(&outlet),
            changes: changed,
            shared: Arc::new(Shared::new(Intake::new(HOLDS, false, []), None)),
            lost: Arc::default(),
            arrives_within_ns: 1_000_000_000,
        });
        // The status is due later. The queue has three entries for four messages.
        sink.topics[2].due_ns = 2;
        sink.connections = outlet.connections();
        for turn in 0..5 {
            let times = Times { now_ns: 1, now_unix_ns: turn };
            sink.publish(&Board::new(0), times);
        }
        assert_eq!((outlet.sent(), outlet.lost()), (3, 0));
        assert_eq!((sink.waiting.len(), sink.published_to), (1, 1));
        sink.finish();
        assert_eq!(sink.start.lost.load(Ordering::Relaxed), 1, "never published to all");
        outlet.disconnected();
        sink.finish();
        assert_eq!(
            sink.start.lost.load(Ordering::Relaxed),
            1 + 2,
            "what was handed over may not have arrived either"
        );
    }
}
