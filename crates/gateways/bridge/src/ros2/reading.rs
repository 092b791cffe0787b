//! The shared part of both middlewares: the account of messages, and errors.

use std::sync::Arc;
use std::time::Duration;

use joulebus_ros_messages::{Clock, decode};
use rustdds::dds::{CreateError, ReadError};

use crate::mapping::account::Reason;
use crate::mapping::robots::Robots;
use crate::mapping::ros::incoming::{Received, RosRoute};
use crate::ros2::answering::{Asked, Requests};
use crate::shared::Shared;

/// The topic of the simulated clock, as in every ROS 2 program.
pub(crate) const CLOCK_TOPIC: &str = "/clock";
/// Delay until a stop is noticed.
pub(super) const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Reason that ROS 2 could not be joined, or was left.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Ros2Error {
    #[error(
        "cannot take part in ROS domain {domain_id}: {source}. Another process may have its ports, \
         7400 + 250 × domain and on. `ulimit -Hn` limits the topics, three descriptors each"
    )]
    Join { domain_id: u16, source: CreateError },
    #[error(
        "cannot open topic {topic}: {source}. `ulimit -Hn` limits the topics, three descriptors each"
    )]
    Topic { topic: String, source: CreateError },
    #[error("the threads of DDS have ended: {0}")]
    Ended(ReadError),
    #[error("cannot start the runtime: {0}")]
    Runtime(#[from] std::io::Error),
    #[error("ROS 2 over zenoh (RMW_IMPLEMENTATION): {0:#}")]
    Zenoh(anyhow::Error),
}

/// Routes that both middlewares read, and the receivers of their messages.
pub(crate) struct Reading {
    pub(crate) routes: Vec<RosRoute>,
    pub(crate) robots: Robots,
    pub(crate) shared: Arc<Shared>,
    /// Queue of requests of services.
    pub(crate) requests: Arc<Requests>,
}

impl Reading {
    /// Takes a request of the service `name`. Counts it if too many wait.
    pub(super) fn ask(&self, asked: Asked, name: &str) {
        self.shared.count_message();
        if !self.requests.add((asked.client.program(), asked.service), asked) {
            self.shared.account().count(name, Reason::NoAnswer, "a request");
            self.shared.log_news();
        }
    }

    /// Takes a message. `None` for one that has no encoding, which is counted.
    pub(super) fn take(
        &self,
        (route, robot): (usize, u32),
        received: Option<&Received>,
        otherwise: Reason,
    ) {
        self.shared.count_message();
        let (Some(route), Some(name)) = (self.routes.get(route), self.robots.name(robot)) else {
            return;
        };
        // Without simulated time there are no samples. That is logged.
        let Some(now_ns) = self.shared.now_ns() else { return };
        let seen = {
            let mut account = self.shared.account();
            match received {
                Some(received) => route.read(name, received, &mut account),
                None => {
                    account.count(&route.name, otherwise, name);
                    None
                }
            }
        };
        let Some((seen, stamp_ns)) = seen else { return self.shared.log_news() };
        let simulated = self.shared.simulated().zip(stamp_ns);
        // A robot's wall clock is not this host's. A simulation has one clock.
        let at_ns = simulated.map_or(Some(now_ns), |(clock, stamp_ns)| clock.stamp_ns(stamp_ns));
        let Some(at_ns) = at_ns else {
            self.shared.account().count(&route.name, Reason::WrongStamp, name);
            return self.shared.log_news();
        };
        let missing = self.shared.intake().take(robot, &seen, at_ns);
        if let Some(missing) = missing {
            let mut packs = self.routes.iter().filter(|route| route.battery.pack == Some(missing));
            let topic = packs.next().map_or_else(String::new, |route| route.topic.of(name));
            let what = format!("battery of {name} without {topic}");
            self.shared.account().count(&route.name, Reason::Unknown, &what);
            self.shared.log_news();
        }
    }

    /// Takes a message of `/clock`. Counts one that is no time.
    pub(super) fn take_clock(&self, received: Option<&Received>) {
        self.shared.count_message();
        let clock = received.and_then(|received| decode::<Clock>(&received.bytes).ok());
        match clock.and_then(|clock| clock.sim_ns()) {
            Some(sim_ns) => self.shared.set_clock(sim_ns),
            None => {
                self.shared.account().count(CLOCK_TOPIC, Reason::NotCdr, "/clock");
                self.shared.log_news();
            }
        }
    }
}
