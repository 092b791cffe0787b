//! A participant in ROS 2's DDS.
//!
//! One thread takes messages. DDS has two threads of its own, and finds participants again that
//! have left.

mod raw;
mod sink;

use std::collections::{BTreeMap, HashMap, HashSet};
use std::pin::pin;
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use futures_util::StreamExt as _;
use futures_util::stream::SelectAll;
use joulebus_bus::clock;
use joulebus_program::output::say;
use rustdds::dds::{CreateError, ReadError};
use rustdds::no_key::DataReader;
use rustdds::policy::{Durability, History, ResourceLimits};
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, DomainParticipantStatusEvent, GUID, Publisher,
    QosPolicies, QosPolicyBuilder, RTPSEntity as _, StatusEvented as _, Subscriber,
    Topic as DdsTopic, TopicKind,
};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use tokio::time::sleep;

use crate::config::{Ros2Settings, RosWrite};
use crate::mapping::account::Reason;
use crate::mapping::robots::Robots;
use crate::mapping::ros::discovery::announced;
use crate::mapping::ros::incoming::{Received, RosRoute};
use crate::mapping::ros::names::{dds_topic, dds_type};
use crate::ros2::raw::Raw;
use crate::ros2::sink::{Topic, Writer};
use crate::shared::Shared;

pub(crate) use sink::{Counts, RosSink};

/// Maximum number of queued messages of a topic. Of several between two samples the newest counts.
const READ_DEPTH: i32 = 16;
/// Minimum and maximum number of messages of a topic that are kept for readers that have not
/// acknowledged them.
const WRITE_DEPTH: (u64, u64) = (256, 2_048);
/// Time until a reader that does not acknowledge loses its lease, with a margin. The leases of ROS
/// 2 are 10 and 20 s.
const LEASE_NS: u64 = 30_000_000_000;
/// Pause after each topic. DDS's queue for discovery holds 1,024 entries, and does not announce the
/// others.
const ANNOUNCE_PAUSE: Duration = Duration::from_millis(1);
/// Delay until a stop is noticed.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
/// Maximum number of remembered writers. They are remembered so that each is counted once.
const MAX_ANNOUNCED: usize = 100_000;

/// Why ROS 2 could not be joined, or was left.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Ros2Error {
    #[error(
        "cannot take part in ROS domain {domain_id}: {source}. Another process may have its ports, 7400 + 250 × domain and on; \
         `ulimit -Hn` limits the topics, three descriptors each"
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
}

/// The reader of a robot's topic.
struct Incoming {
    route: usize,
    robot: u32,
    reader: DataReader<Received, Raw>,
}

/// The open participant and its readers.
pub(crate) struct Ros2 {
    participant: DomainParticipant,
    routes: Vec<RosRoute>,
    robots: Robots,
    incoming: Vec<Incoming>,
    /// The topic of each of our endpoints, for error messages.
    endpoints: HashMap<GUID, String>,
    shared: Arc<Shared>,
}

impl Ros2 {
    /// Joins the domain and opens all topics. The threads of DDS inherit the priority of the
    /// calling thread.
    ///
    /// # Errors
    /// [`Ros2Error`].
    pub(crate) fn open(
        settings: &Ros2Settings,
        (fleet, name): (&str, &str),
        robots: &Robots,
        shared: &Arc<Shared>,
        counts: &Arc<Counts>,
    ) -> Result<(Self, RosSink), Ros2Error> {
        allow_descriptors();
        let mut builder = DomainParticipantBuilder::new(settings.domain_id);
        if !settings.networks.is_empty() {
            builder = builder.with_only_networks(settings.networks.iter().copied());
        }
        let join = |source| Ros2Error::Join { domain_id: settings.domain_id, source };
        let participant = builder.build().map_err(join)?;
        let usual = QosPolicies::qos_none();
        let subscriber = participant.create_subscriber(&usual).map_err(join)?;
        let publisher = participant.create_publisher(&usual).map_err(join)?;
        let mut ros = Self {
            participant,
            routes: settings.routes.clone(),
            robots: robots.clone(),
            incoming: Vec::new(),
            endpoints: HashMap::new(),
            shared: Arc::clone(shared),
        };
        ros.open_readers(&subscriber)?;
        let topics = settings.writes.iter().map(|write| ros.open_writers(&publisher, write));
        let topics = topics.collect::<Result<Vec<Topic>, Ros2Error>>()?;
        let written: usize = topics.iter().map(|topic| topic.writers.len()).sum();
        say(&format!(
            "in ROS domain {} as participant {}: {} topics read, {written} written",
            settings.domain_id,
            ros.participant.participant_id(),
            ros.incoming.len(),
        ));
        let sink = RosSink {
            fleet: fleet.to_owned(),
            name: name.to_owned(),
            robots: robots.clone(),
            topics,
            counts: Arc::clone(counts),
            shared: Arc::clone(shared),
        };
        Ok((ros, sink))
    }

    fn open_readers(&mut self, subscriber: &Subscriber) -> Result<(), Ros2Error> {
        // Best effort is compatible with reliable and best-effort publishers. A repeated reading
        // would be old.
        let qos = QosPolicyBuilder::new()
            .best_effort()
            .durability(Durability::Volatile)
            .history(History::KeepLast { depth: READ_DEPTH })
            .build();
        for (place, route) in self.routes.iter().enumerate() {
            for (robot, name) in self.robots.iter() {
                let name = route.topic.of(name);
                let kind = dds_type(route.kind);
                let opened = self
                    .topic(&name, &kind, &qos)
                    .and_then(|topic| subscriber.create_datareader_no_key(&topic, None));
                let reader: DataReader<Received, Raw> = opened.map_err(|source| {
                    let topic = name.clone();
                    Ros2Error::Topic { topic, source }
                })?;
                self.endpoints.insert(reader.guid(), name);
                self.incoming.push(Incoming { route: place, robot, reader });
                thread::sleep(ANNOUNCE_PAUSE);
            }
        }
        Ok(())
    }

    fn open_writers(
        &mut self,
        publisher: &Publisher,
        write: &RosWrite,
    ) -> Result<Topic, Ros2Error> {
        let (least, most) = WRITE_DEPTH;
        let depth = (LEASE_NS / write.every_ns).clamp(least, most) as i32;
        // Reliable is compatible with reliable and best-effort subscribers. A message for a full
        // queue is counted at once, because the bridge never waits for a reader.
        let qos = QosPolicyBuilder::new()
            .reliable(rustdds::Duration::ZERO)
            .durability(Durability::Volatile)
            .history(History::KeepLast { depth: 1 })
            .resource_limits(ResourceLimits {
                max_samples: depth,
                max_instances: 1,
                max_samples_per_instance: depth,
            })
            .build();
        let robots: Vec<(u32, String)> = if write.what.is_of_robot() {
            let topic = |(robot, name): (u32, &str)| (robot, write.topic.of(name));
            self.robots.iter().map(topic).collect()
        } else {
            vec![(0, write.topic.of(""))]
        };
        let mut writers = BTreeMap::new();
        for (robot, name) in robots {
            let opened = self
                .topic(&name, write.what.dds_type(), &qos)
                .and_then(|topic| publisher.create_datawriter_no_key(&topic, None));
            let writer: Writer = opened.map_err(|source| {
                let topic = name.clone();
                Ros2Error::Topic { topic, source }
            })?;
            self.endpoints.insert(writer.guid(), name);
            writers.insert(robot, writer);
            thread::sleep(ANNOUNCE_PAUSE);
        }
        Ok(Topic { write: write.clone(), writers, due_ns: 0 })
    }

    fn topic(&self, name: &str, kind: &str, qos: &QosPolicies) -> Result<DdsTopic, CreateError> {
        let (name, kind) = (dds_topic(name), kind.to_owned());
        self.participant.create_topic(name, kind, qos, TopicKind::NoKey)
    }

    /// Takes messages until the bridge stops.
    ///
    /// # Errors
    /// [`Ros2Error`].
    pub(crate) fn run(self) -> Result<(), Ros2Error> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build()?;
        runtime.block_on(self.serve())
    }

    async fn serve(mut self) -> Result<(), Ros2Error> {
        let mut messages = SelectAll::new();
        for incoming in std::mem::take(&mut self.incoming) {
            let of = (incoming.route, incoming.robot);
            let stream = incoming.reader.async_sample_stream();
            messages.push(stream.map(move |read| (of, read)));
        }
        let listener = self.participant.status_listener();
        let mut events = pin!(listener.as_async_status_stream());
        let mut seen = HashSet::new();
        loop {
            tokio::select! {
                Some((of, read)) = messages.next() => match read {
                    Ok(sample) => self.take(of, Some(sample.value())),
                    Err(ReadError::Deserialization { .. }) => self.take(of, None),
                    // These topics have no keys.
                    Err(ReadError::UnknownKey { .. }) => {}
                    Err(error) => return Err(Ros2Error::Ended(error)),
                },
                Some(event) = events.next() => self.heed(event, &mut seen),
                () = closed(&self.shared) => return Ok(()),
            }
        }
    }

    /// Takes a message. `None` if it is not plain CDR.
    fn take(&self, (route, robot): (usize, u32), received: Option<&Received>) {
        let at_ns = clock::monotonic_ns();
        self.shared.count_message();
        let (Some(route), Some(name)) = (self.routes.get(route), self.robots.name(robot)) else {
            return;
        };
        let seen = {
            let mut account = self.shared.account();
            match received {
                Some(received) => route.read(name, received, &mut account),
                None => {
                    account.count(&route.name, Reason::WrongEncoding, name);
                    None
                }
            }
        };
        match seen {
            Some(seen) => self.shared.intake().take(robot, &seen, at_ns),
            None => self.shared.log_news(),
        }
    }

    /// Handles an event of discovery.
    fn heed(&self, event: DomainParticipantStatusEvent, seen: &mut HashSet<GUID>) {
        use DomainParticipantStatusEvent as Event;
        match event {
            Event::WriterDetected { writer } => {
                let is_new = seen.len() < MAX_ANNOUNCED && seen.insert(writer.guid);
                if is_new {
                    let topic = (writer.topic_name.as_str(), writer.type_name.as_str());
                    announced(&self.routes, &self.robots, topic, &mut self.shared.account());
                }
            }
            Event::WriterLost { guid, .. } => {
                seen.remove(&guid);
            }
            Event::RemoteWriterQosIncompatible { local_reader: ours, .. }
            | Event::RemoteReaderQosIncompatible { local_writer: ours, .. } => {
                if let Some(topic) = self.endpoints.get(&ours) {
                    let mut account = self.shared.account();
                    account.count(topic, Reason::IncompatibleQos, "a participant");
                }
            }
            _ => {}
        }
        self.shared.log_news();
    }
}

/// Returns when the connection has to end.
async fn closed(shared: &Shared) {
    while !shared.is_closed() {
        sleep(POLL_INTERVAL).await;
    }
}

/// Raises the limit of descriptors to the maximum of this process, because DDS needs several for
/// each topic.
fn allow_descriptors() {
    let Rlimit { maximum, .. } = getrlimit(Resource::Nofile);
    let all = Rlimit { current: maximum, maximum };
    if let Err(error) = setrlimit(Resource::Nofile, all) {
        tracing::warn!(%error, "the limit of file descriptors stays");
    }
}
