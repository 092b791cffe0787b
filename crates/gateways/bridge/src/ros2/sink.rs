//! The sink of ROS 2: forecasts, budgets and values of each robot, and the diagnostics of all.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use joulebus_board::{Board, Link};
use joulebus_ros_messages::{RosError, encode};

use crate::config::RosWrite;
use crate::mapping::outgoing::values;
use crate::mapping::robots::Robots;
use crate::mapping::ros::outgoing::{
    RosWhat, add_clock, add_implausible, budget, diagnostics, forecast, outlook as outlook_message,
    robot_status, unknown_status, value, worker_status,
};
use crate::mapping::simulated::ClockState;
use crate::outbound::{Sink, Times, next_due_ns};
use crate::ros2::writer::Writer;
use crate::shared::Shared;

/// A topic with its writers.
pub(crate) struct Topic {
    pub(super) write: RosWrite,
    /// Writers by robot. A topic of the fleet has one, under 0.
    pub(super) writers: BTreeMap<u32, Writer>,
    pub(super) due_ns: u64,
}

/// Numbers of published and of rejected messages.
#[derive(Debug, Default)]
pub(crate) struct Counts {
    sent: AtomicU64,
    lost: AtomicU64,
}

impl Counts {
    /// Number of messages handed to the middleware.
    pub(crate) fn sent(&self) -> u64 {
        self.sent.load(Ordering::Relaxed)
    }

    /// Number of messages without room, because a reader does not acknowledge.
    pub(crate) fn lost(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }

    fn write(&self, writer: &Writer, message: Result<Vec<u8>, RosError>) {
        self.count(message.is_ok_and(|message| writer.write(message)));
    }

    pub(super) fn count(&self, is_sent: bool) {
        let count = if is_sent { &self.sent } else { &self.lost };
        count.fetch_add(1, Ordering::Relaxed);
    }
}

/// Publishes to ROS 2.
pub(crate) struct RosSink {
    pub(crate) fleet: String,
    pub(crate) name: String,
    pub(crate) robots: Robots,
    pub(crate) topics: Vec<Topic>,
    pub(crate) counts: Arc<Counts>,
    pub(crate) shared: Arc<Shared>,
}

impl Sink for RosSink {
    fn publish(&mut self, board: &Board, times: Times) {
        let (clock, sample_times) = self.sample_times(times);
        for place in 0..self.topics.len() {
            let topic = &mut self.topics[place];
            if times.now_ns < topic.due_ns {
                continue;
            }
            topic.due_ns = next_due_ns(topic.due_ns, topic.write.every_ns, times.now_ns);
            let topic = &self.topics[place];
            match topic.write.what {
                RosWhat::Diagnostics => self.diagnose(topic, board, clock, sample_times),
                // Without simulated time no robot has been seen.
                _ if clock == ClockState::Missing => {}
                _ => self.publish_robots(topic, board, sample_times),
            }
        }
    }

    fn finish(&mut self) {}
}

impl RosSink {
    /// True if there is any topic to publish to.
    pub(crate) fn has_topics(&self) -> bool {
        !self.topics.is_empty()
    }

    /// State of the clock of samples, and the present on it.
    fn sample_times(&self, times: Times) -> (ClockState, Times) {
        let Some(clock) = self.shared.simulated() else { return (ClockState::Runs, times) };
        let (now_ns, now_unix_ns) = clock.now_ns().unwrap_or_default();
        (clock.state(times.now_ns), Times { now_ns, now_unix_ns })
    }

    fn publish_robots(&self, topic: &Topic, board: &Board, times: Times) {
        // Without a worker there are no values. The diagnostics report that.
        if !board.is_reliable {
            return;
        }
        for (robot, row) in &board.rows {
            let (Some(name), Some(writer)) = (self.robots.name(*robot), topic.writers.get(robot))
            else {
                continue;
            };
            let outlook = board.outlooks.get(robot);
            let unix_ns = |at_ns| times.unix_ns(at_ns);
            let values = values((*robot, name), &row.newest(), outlook, unix_ns);
            let voltage_v = self.shared.intake().voltage_v(*robot, times.now_ns);
            let message = match (topic.write.what, &topic.write.value) {
                (RosWhat::Outlook, _) => encode(&outlook_message(name, &values)),
                (RosWhat::Budget, _) => encode(&budget(name, &values, voltage_v)),
                (RosWhat::Value, Some(name)) => encode(&value(name, &values)),
                _ => encode(&forecast(name, &values, voltage_v)),
            };
            self.counts.write(writer, message);
        }
    }

    fn diagnose(&self, topic: &Topic, board: &Board, clock: ClockState, times: Times) {
        let Some(writer) = topic.writers.get(&0) else {
            return;
        };
        let level = match board.link {
            Link::Live => 0,
            Link::Waiting | Link::Stale => 1,
            Link::Gone | Link::Ended => 2,
        };
        let counts = [
            ("messages", self.shared.messages()),
            ("not_mapped", self.shared.account().lost()),
            ("written", self.counts.sent()),
            ("not_written", self.counts.lost()),
        ];
        let worker = (level, board.link.name());
        let mut worker = worker_status((&self.fleet, &self.name), worker, counts);
        add_clock(&mut worker, clock);
        let mut statuses = vec![worker];
        let implausible = self.shared.intake().judgement().records();
        statuses.extend(self.robots.iter().map(|(robot, name)| {
            let row = board.rows.get(&robot).filter(|_| board.link == Link::Live);
            let mut status = row.map_or_else(
                || unknown_status(name, board.link.name()),
                |row| {
                    let unix_ns = |at_ns| times.unix_ns(at_ns);
                    robot_status(name, &values((robot, name), &row.newest(), None, unix_ns))
                },
            );
            for found in implausible.iter().filter(|found| found.robot == robot) {
                add_implausible(&mut status, found);
            }
            status
        }));
        self.counts.write(writer, encode(&diagnostics(times.now_unix_ns, statuses)));
    }
}
