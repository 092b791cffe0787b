//! The thread that reads the fleet as a planner, and tells what the file asks for.

use std::cell::RefCell;
use std::collections::{BTreeSet, HashMap, VecDeque};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError};

use joulebus_board::{AlarmRecord, Board, Link, Reading};
use joulebus_bus::clock;
use joulebus_config::Config;
use joulebus_consumer::{FleetAlarm, FleetAlarms};
use rumqttc::QoS;
use serde_json::{Value, json};

use crate::config::Write;
use crate::mapping::outgoing::{Object, What, document, values};
use crate::mapping::robots::Robots;
use crate::mqtt::Outlet;
use crate::shared::Shared;

/// Changes of alarms that wait for a connection; further ones are lost.
pub(crate) const MOST_WAITING: usize = 10_000;

/// What is told by which topic.
struct Topic {
    write: Write,
    due_ns: u64,
    /// The newest document of each robot, where only changes are told.
    told: HashMap<u32, Value>,
    /// Robots with a document that the broker keeps.
    kept: BTreeSet<u32>,
}

/// Reads and tells.
pub(crate) struct Telling {
    fleet: String,
    name: String,
    robots: Robots,
    topics: Vec<Topic>,
    reading: Reading,
    board: RefCell<Board>,
    changes: Receiver<FleetAlarm>,
    waiting: VecDeque<AlarmRecord>,
    /// Handed to the connection lately, and when, monotonic ns: if it breaks, they may not have arrived.
    handed: VecDeque<(u64, AlarmRecord)>,
    arrives_within_ns: u64,
    outlet: Arc<Outlet>,
    connections: u64,
    shared: Arc<Shared>,
    lost: Arc<AtomicU64>,
}

/// What a [`Telling`] starts with.
pub(crate) struct Start {
    pub(crate) name: String,
    pub(crate) robots: Robots,
    pub(crate) writes: Vec<Write>,
    pub(crate) outlet: Arc<Outlet>,
    pub(crate) changes: Receiver<FleetAlarm>,
    pub(crate) shared: Arc<Shared>,
    pub(crate) lost: Arc<AtomicU64>,
    /// After which a message has arrived, or the connection is known to be broken, ns.
    pub(crate) arrives_within_ns: u64,
}

impl Telling {
    /// Joins the fleet.
    ///
    /// # Errors
    /// It cannot be joined.
    pub(crate) fn open(config: &Config, start: Start) -> anyhow::Result<Self> {
        let topic = |write: Write| Topic {
            due_ns: 0,
            told: HashMap::new(),
            // The broker may keep documents of an earlier run.
            kept: start
                .robots
                .iter()
                .map(|(robot, _)| robot)
                .filter(|_| write.retain)
                .collect(),
            write,
        };
        let topics = start.writes.into_iter().map(topic).collect();
        Ok(Self {
            fleet: config.fleet().to_owned(),
            reading: Reading::open(config, &start.name, false)?,
            name: start.name,
            robots: start.robots,
            topics,
            board: RefCell::new(Board::new(clock::monotonic_ns())),
            changes: start.changes,
            waiting: VecDeque::new(),
            handed: VecDeque::new(),
            arrives_within_ns: start.arrives_within_ns,
            connections: 0,
            outlet: start.outlet,
            shared: start.shared,
            lost: start.lost,
        })
    }

    /// Reads and tells until the bridge stops.
    ///
    /// # Errors
    /// Reading fails permanently.
    pub(crate) fn run(mut self) -> anyhow::Result<()> {
        while !self.shared.is_stopped() {
            let Self { reading, board, .. } = &mut self;
            reading.turn(|| board.borrow_mut())?;
            let times = Times::now();
            self.take_changes(times);
            if self.outlet.is_connected() {
                self.tell(times);
            }
        }
        self.lost
            .fetch_add(self.waiting.len() as u64, Ordering::Relaxed);
        Ok(())
    }

    fn take_changes(&mut self, times: Times) {
        for change in self.changes.try_iter() {
            if self.waiting.len() >= MOST_WAITING {
                self.waiting.pop_front();
                self.lost.fetch_add(1, Ordering::Relaxed);
            }
            let record = AlarmRecord::new(&self.fleet, &change, times.unix_ns(change.at_ns));
            self.waiting.push_back(record);
        }
    }

    fn tell(&mut self, times: Times) {
        let connections = self.outlet.connections();
        if connections != self.connections {
            // Another broker, or one that has forgotten: everything is news.
            self.connections = connections;
            for topic in &mut self.topics {
                topic.due_ns = 0;
                topic.told.clear();
                if topic.write.retain {
                    // So may the end of what it kept be.
                    topic.kept = self.robots.iter().map(|(robot, _)| robot).collect();
                }
            }
            while let Some((_, record)) = self.handed.pop_back() {
                self.waiting.push_front(record);
            }
        }
        for place in 0..self.topics.len() {
            match self.topics[place].write.what {
                What::AlarmChanges => {}
                _ if times.now_ns < self.topics[place].due_ns => {}
                What::Status => self.tell_status(place, times),
                _ => self.tell_robots(place, times),
            }
        }
        self.tell_changes(times.now_ns);
    }

    fn tell_changes(&mut self, now_ns: u64) {
        let since_ns = now_ns.saturating_sub(self.arrives_within_ns);
        while self
            .handed
            .front()
            .is_some_and(|(at_ns, _)| *at_ns < since_ns)
        {
            self.handed.pop_front();
        }
        let topics = self
            .topics
            .iter()
            .filter(|topic| topic.write.what == What::AlarmChanges);
        let topics: Vec<&Topic> = topics.collect();
        while let Some(record) = self.waiting.front() {
            let name = record.robot.and_then(|robot| self.robots.name(robot));
            let mut document = json!(record);
            document["name"] = json!(name);
            let payload = document.to_string().into_bytes();
            let is_told = topics.iter().all(|topic| {
                let write = &topic.write;
                self.outlet.write(
                    write.topic.of(""),
                    payload.clone(),
                    QoS::AtLeastOnce,
                    write.retain,
                )
            });
            if !is_told {
                return;
            }
            let record = self.waiting.pop_front();
            self.handed.extend(record.map(|record| (now_ns, record)));
        }
    }

    fn tell_status(&mut self, place: usize, times: Times) {
        let topic = &mut self.topics[place];
        let status = json!({
            "fleet": self.fleet,
            "bridge": self.name,
            "state": "online",
            "at_unix_ns": times.now_unix_ns,
            "worker": self.board.borrow().link.name(),
            "messages": self.shared.messages(),
            "unmapped": self.shared.account().records(),
        });
        let (to, retain) = (topic.write.topic.of(""), topic.write.retain);
        if self.outlet.write(
            to,
            status.to_string().into_bytes(),
            QoS::AtLeastOnce,
            retain,
        ) {
            topic.due_ns = times.now_ns + topic.write.every_ns;
        }
    }

    fn tell_robots(&mut self, place: usize, times: Times) {
        let (board, topic) = (self.board.borrow(), &mut self.topics[place]);
        topic.due_ns = times.now_ns + topic.write.every_ns;
        // Without a worker nothing is known; its status says so.
        if board.link != Link::Live {
            return;
        }
        let mut left = topic.kept.clone();
        for (robot, row) in &board.rows {
            let Some(name) = self.robots.name(*robot) else {
                continue;
            };
            left.remove(robot);
            let values = values(*robot, name, &row.newest(), |at_ns| times.unix_ns(at_ns));
            topic.tell(*robot, name, &values, &self.outlet);
        }
        for robot in left {
            // An empty message ends what a broker keeps.
            let to = topic
                .write
                .topic
                .of(self.robots.name(robot).unwrap_or_default());
            if self.outlet.write(to, Vec::new(), QoS::AtLeastOnce, true) {
                topic.kept.remove(&robot);
                topic.told.remove(&robot);
            }
        }
    }
}

impl Topic {
    fn tell(&mut self, robot: u32, name: &str, values: &Object, outlet: &Outlet) {
        let document = document(&self.write.fields, values);
        let only_changes = self.write.what == What::Alarms;
        if only_changes && self.told.get(&robot) == Some(&document) {
            return;
        }
        let qos = if self.write.what == What::Forecast {
            QoS::AtMostOnce
        } else {
            QoS::AtLeastOnce
        };
        let payload = document.to_string().into_bytes();
        if outlet.write(self.write.topic.of(name), payload, qos, self.write.retain) {
            if only_changes {
                self.told.insert(robot, document);
            }
            if self.write.retain {
                self.kept.insert(robot);
            }
        }
    }
}

/// This moment on both clocks.
#[derive(Debug, Clone, Copy)]
struct Times {
    now_ns: u64,
    now_unix_ns: u64,
}

impl Times {
    fn now() -> Self {
        Self {
            now_ns: clock::monotonic_ns(),
            now_unix_ns: clock::unix_ns(),
        }
    }

    /// Unix time of a monotonic one, which may lie ahead.
    const fn unix_ns(self, at_ns: u64) -> u64 {
        let ago_ns = self.now_ns as i128 - at_ns as i128;
        (self.now_unix_ns as i128 - ago_ns) as u64
    }
}

/// Hands every change of an alarm over until the bridge stops.
///
/// # Errors
/// The fleet cannot be joined or read.
pub(crate) fn read_alarms(
    config: &Config,
    name: &str,
    to: &SyncSender<FleetAlarm>,
    shared: &Shared,
    lost: &AtomicU64,
) -> anyhow::Result<()> {
    let mut alarms = FleetAlarms::with_config(config, name)?;
    while !shared.is_stopped() {
        alarms.wait(|change| {
            if let Err(TrySendError::Full(_)) = to.try_send(change) {
                lost.fetch_add(1, Ordering::Relaxed);
            }
        })?;
    }
    lost.fetch_add(alarms.history().ticks_missed(), Ordering::Relaxed);
    Ok(())
}
