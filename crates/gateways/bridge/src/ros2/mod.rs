//! A participant in ROS 2's DDS.
//!
//! One thread takes messages. DDS has two threads of its own, and finds participants again that
//! have left.

mod answering;
mod raw;
mod reading;
mod rmw;
mod sink;
mod writer;

use std::collections::{BTreeMap, HashMap, HashSet};
use std::pin::pin;
use std::thread;
use std::time::Duration;

use futures_util::StreamExt as _;
use futures_util::stream::SelectAll;
use joulebus_program::output::log_line;
use joulebus_ros_messages::{Clock, encode};
use rustdds::dds::{CreateError, ReadError};
use rustdds::no_key::{DataReader, DataSample};
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
use crate::mapping::ros::discovery::{GRAPH, ParticipantEntities, announced};
use crate::mapping::ros::incoming::Received;
use crate::mapping::ros::names::{dds_topic, dds_type, ros_type};
use crate::mapping::ros::outgoing::{RosWhat, STATUS_BYTES};
use crate::mapping::ros::services::Service;
use crate::ros2::answering::Asked;
use crate::ros2::raw::Raw;
use crate::ros2::reading::{POLL_INTERVAL, Ros2Error};
use crate::ros2::sink::Topic;
use crate::ros2::writer::{Client, DdsWriter, Writer};
use crate::shared::Shared;

pub(crate) use answering::{Answering, Requests};
pub(crate) use reading::{CLOCK_TOPIC, Reading};
pub(crate) use rmw::{Zenoh, is_zenoh};
pub(crate) use sink::{Counts, RosSink};

/// Maximum number of queued messages of a topic. The newest of several between two samples counts.
const MAX_QUEUED: i32 = 16;
/// Minimum and maximum number of messages of a topic that are kept for readers that have not
/// acknowledged them. RustDDS also keeps as many of a latched topic until its first reader comes.
const WRITE_DEPTH: (u64, u64) = (256, 2_048);
/// Maximum size of the diagnostics that are kept, bytes, and a number that is kept in any case.
const MAX_DIAGNOSTICS: (usize, u64) = (64 << 20, 32);
/// Time until a reader that does not acknowledge loses its lease, with a margin. The leases of ROS
/// 2 are 10 and 20 s.
const LEASE_NS: u64 = 30_000_000_000;
/// Pause after each topic. DDS's queue for discovery holds 1,024 entries, and does not announce the
/// others.
const ANNOUNCE_PAUSE: Duration = Duration::from_millis(1);
/// Maximum number of remembered writers. They are remembered so that each is counted once.
const MAX_ANNOUNCED: usize = 100_000;
/// Time without any message after which the log names the usual reason.
const SILENCE: Duration = Duration::from_secs(5);
/// Maximum memory of this process, bytes. A thousand robots take a tenth of it.
const MAX_DATA_BYTES: u64 = 1 << 30;

/// The reader of a robot's topic.
struct Incoming {
    route: usize,
    robot: u32,
    reader: DataReader<Received, Raw>,
}

/// Services keep this many requests and responses, as in their profile of ROS 2.
const SERVICE_DEPTH: i32 = 10;
/// The first bytes of ids of Cyclone DDS: its number as a vendor.
const CYCLONE: [u8; 2] = [1, 0x10];

/// The open participant and its readers.
pub(crate) struct Ros2 {
    /// Announces the node to participants that come later. Dropped before the participant, without
    /// which RustDDS logs an error.
    graph: Option<DdsWriter>,
    participant: DomainParticipant,
    reading: Reading,
    incoming: Vec<Incoming>,
    /// The reader of the simulated clock.
    clock: Option<DataReader<Received, Raw>>,
    /// Readers of requests, and the services' names.
    services: Vec<(DataReader<Received, Raw>, String)>,
    /// The topic of each of our endpoints, for error messages.
    endpoints: HashMap<GUID, String>,
}

impl Ros2 {
    /// Joins the domain and opens all topics and services, whose writers of responses it returns.
    /// The threads of DDS inherit the priority of the calling thread.
    pub(crate) fn open(
        settings: &Ros2Settings,
        reading: Reading,
        sink: &mut RosSink,
    ) -> Result<(Self, Vec<Writer>), Ros2Error> {
        limit_resources();
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
            reading,
            incoming: Vec::new(),
            clock: None,
            services: Vec::new(),
            endpoints: HashMap::new(),
            graph: None,
        };
        ros.open_readers(&subscriber)?;
        let topics = settings.writes.iter().map(|write| ros.open_writers(&publisher, write));
        let topics = topics.collect::<Result<Vec<Topic>, Ros2Error>>()?;
        let services = settings.services.iter();
        let services = services.map(|service| ros.open_service(service, &subscriber, &publisher));
        let repliers = services.collect::<Result<Vec<Writer>, Ros2Error>>()?;
        let written: usize = topics.iter().map(|topic| topic.writers.len()).sum();
        log_line(&format!(
            "in ROS domain {} as participant {}: {} topics read, {written} written, {} services",
            settings.domain_id,
            ros.participant.participant_id(),
            ros.incoming.len() + usize::from(ros.clock.is_some()),
            repliers.len(),
        ));
        ros.announce_node(&publisher, &sink.name)?;
        sink.topics = topics;
        Ok((ros, repliers))
    }

    fn open_readers(&mut self, subscriber: &Subscriber) -> Result<(), Ros2Error> {
        // Best effort is compatible with reliable and best-effort publishers. A repeated reading
        // would be old.
        let qos = QosPolicyBuilder::new()
            .best_effort()
            .durability(Durability::Volatile)
            .history(History::KeepLast { depth: MAX_QUEUED })
            .build();
        for place in 0..self.reading.routes.len() {
            let route = &self.reading.routes[place];
            let of_robots = self.reading.robots.iter();
            let of_robots = of_robots.map(|(robot, name)| (robot, route.topic.of(name)));
            let (kind, of_robots) = (ros_type(route.kind), of_robots.collect::<Vec<_>>());
            for (robot, name) in of_robots {
                let reader = self.open_reader(subscriber, name, kind, &qos)?;
                self.incoming.push(Incoming { route: place, robot, reader });
            }
        }
        if self.reading.shared.simulated().is_some() {
            let name = CLOCK_TOPIC.to_owned();
            self.clock = Some(self.open_reader(subscriber, name, Clock::NAME, &qos)?);
        }
        Ok(())
    }

    fn open_reader(
        &mut self,
        subscriber: &Subscriber,
        name: String,
        kind: &str,
        qos: &QosPolicies,
    ) -> Result<DataReader<Received, Raw>, Ros2Error> {
        let opened = self
            .topic(dds_topic(&name), dds_type(kind), qos)
            .and_then(|topic| subscriber.create_datareader_no_key(&topic, None));
        let reader: DataReader<Received, Raw> = opened.map_err(|source| {
            let topic = name.clone();
            Ros2Error::Topic { topic, source }
        })?;
        self.endpoints.insert(reader.guid(), name);
        thread::sleep(ANNOUNCE_PAUSE);
        Ok(reader)
    }

    fn open_writers(
        &mut self,
        publisher: &Publisher,
        write: &RosWrite,
    ) -> Result<Topic, Ros2Error> {
        let depth = depth(write, self.reading.robots.len());
        // Reliable is compatible with reliable and best-effort subscribers. A message for a full
        // queue is counted at once, because the bridge never waits for a reader.
        let qos = QosPolicyBuilder::new()
            .reliable(rustdds::Duration::ZERO)
            .durability(if write.what.is_latched() {
                Durability::TransientLocal
            } else {
                Durability::Volatile
            })
            .history(History::KeepLast { depth: 1 })
            .resource_limits(ResourceLimits {
                max_samples: depth,
                max_instances: 1,
                max_samples_per_instance: depth,
            })
            .build();
        let robots: Vec<(u32, String)> = if write.what.is_of_robot() {
            let topic = |(robot, name): (u32, &str)| (robot, write.topic.of(name));
            self.reading.robots.iter().map(topic).collect()
        } else {
            vec![(0, write.topic.of(""))]
        };
        let mut writers = BTreeMap::new();
        for (robot, name) in robots {
            let opened = self
                .topic(dds_topic(&name), dds_type(write.what.type_name()), &qos)
                .and_then(|topic| publisher.create_datawriter_no_key(&topic, None));
            let writer: DdsWriter = opened.map_err(|source| {
                let topic = name.clone();
                Ros2Error::Topic { topic, source }
            })?;
            self.endpoints.insert(writer.guid(), name);
            writers.insert(robot, Writer::Dds(Box::new(writer)));
            thread::sleep(ANNOUNCE_PAUSE);
        }
        Ok(Topic { write: write.clone(), writers, due_ns: 0 })
    }

    /// Opens a service, and returns the writer of its responses.
    fn open_service(
        &mut self,
        (service, name): &(Service, String),
        subscriber: &Subscriber,
        publisher: &Publisher,
    ) -> Result<Writer, Ros2Error> {
        let qos = QosPolicyBuilder::new()
            .reliable(rustdds::Duration::ZERO)
            .durability(Durability::Volatile)
            .history(History::KeepLast { depth: SERVICE_DEPTH })
            .build();
        let [(asks, request), (replies, response)] = service.topics(name);
        let opened = self.topic(asks, request, &qos).and_then(|asks| {
            let replies = self.topic(replies, response, &qos)?;
            let reader = subscriber.create_datareader_no_key(&asks, None)?;
            Ok((reader, publisher.create_datawriter_no_key(&replies, None)?))
        });
        let topic = name.clone();
        let (reader, writer): (DataReader<Received, Raw>, DdsWriter) =
            opened.map_err(|source| Ros2Error::Topic { topic, source })?;
        self.endpoints.extend([(reader.guid(), name.clone()), (writer.guid(), name.clone())]);
        self.services.push((reader, name.clone()));
        Ok(Writer::Dds(Box::new(writer)))
    }

    /// Announces the node with its endpoints in the graph of ROS 2.
    fn announce_node(&mut self, publisher: &Publisher, bridge: &str) -> Result<(), Ros2Error> {
        let (name, kind) = GRAPH;
        let qos = QosPolicyBuilder::new()
            .reliable(rustdds::Duration::ZERO)
            .durability(Durability::TransientLocal)
            .history(History::KeepLast { depth: 1 })
            .build();
        let name = name.to_owned();
        let opened = self
            .topic(name.clone(), kind.to_owned(), &qos)
            .and_then(|topic| publisher.create_datawriter_no_key(&topic, None));
        let graph: DdsWriter = opened.map_err(|source| Ros2Error::Topic { topic: name, source })?;
        let (readers, writers): (Vec<GUID>, Vec<GUID>) =
            self.endpoints.keys().partition(|guid| guid.entity_id.kind().is_reader());
        let bytes = |guids: Vec<GUID>| guids.into_iter().map(|guid| guid.to_bytes()).collect();
        let participant = self.participant.guid().to_bytes();
        let entities =
            ParticipantEntities::new(participant, bridge, (bytes(readers), bytes(writers)));
        let is_sent = encode(&entities).is_ok_and(|message| graph.write(message, None).is_ok());
        if !is_sent {
            tracing::warn!("the node of ROS 2's graph is not announced");
        }
        self.graph = Some(graph);
        Ok(())
    }

    fn topic(
        &self,
        name: String,
        kind: String,
        qos: &QosPolicies,
    ) -> Result<DdsTopic, CreateError> {
        self.participant.create_topic(name, kind, qos, TopicKind::NoKey)
    }

    /// Takes messages until the bridge stops.
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
        let (mut requests, mut names) = (SelectAll::new(), Vec::new());
        for (place, (reader, name)) in std::mem::take(&mut self.services).into_iter().enumerate() {
            requests.push(reader.async_sample_stream().map(move |read| (place, read)));
            names.push(name);
        }
        let clock = std::mem::take(&mut self.clock).into_iter();
        let mut clock: SelectAll<_> = clock.map(|reader| reader.async_sample_stream()).collect();
        let listener = self.participant.status_listener();
        let mut events = pin!(listener.as_async_status_stream());
        let mut seen = HashSet::new();
        let encoding = Reason::WrongEncoding;
        let (mut silence, mut has_looked) = (pin!(sleep(SILENCE)), messages.is_empty());
        loop {
            tokio::select! {
                Some((of, read)) = messages.next() => match read {
                    Ok(sample) => self.reading.take(of, Some(sample.value()), encoding),
                    Err(ReadError::Deserialization { .. }) => self.reading.take(of, None, encoding),
                    // These topics have no keys.
                    Err(ReadError::UnknownKey { .. }) => {}
                    Err(error) => return Err(Ros2Error::Ended(error)),
                },
                Some(read) = clock.next() => match read {
                    Ok(sample) => self.reading.take_clock(Some(sample.value())),
                    Err(ReadError::Deserialization { .. }) => self.reading.take_clock(None),
                    Err(ReadError::UnknownKey { .. }) => {}
                    Err(error) => return Err(Ros2Error::Ended(error)),
                },
                Some((place, read)) = requests.next() => match read {
                    Ok(sample) => self.ask((place, &names[place]), sample),
                    Err(ReadError::Deserialization { .. } | ReadError::UnknownKey { .. }) => {}
                    Err(error) => return Err(Ros2Error::Ended(error)),
                },
                Some(event) = events.next() => self.heed(event, &mut seen),
                () = &mut silence, if !has_looked => {
                    has_looked = true;
                    self.warn_if_silent();
                }
                () = closed(&self.reading.shared) => return Ok(()),
            }
        }
    }

    /// Robots on another middleware are invisible.
    fn warn_if_silent(&self) {
        if self.reading.shared.messages() == 0 {
            tracing::warn!(
                domain_id = self.participant.domain_id(),
                "no message of a robot has come by DDS in {} s. For robots on rmw_zenoh_cpp, set \
                 RMW_IMPLEMENTATION=rmw_zenoh_cpp for the bridge too",
                SILENCE.as_secs()
            );
        }
    }

    /// Takes a request. Responses name it as its client's vendor does.
    fn ask(&self, (service, name): (usize, &str), sample: DataSample<Received>) {
        let about = sample.sample_info();
        let (mut identity, related) = (about.sample_identity(), about.related_sample_identity());
        let is_cyclone = identity.writer_guid.to_bytes()[..2] == CYCLONE;
        // Fast DDS names the client's reader beside the request.
        let reader = related.map(|related| related.writer_guid);
        if let Some(reader) = reader.filter(|reader| *reader != GUID::GUID_UNKNOWN) {
            identity.writer_guid = reader;
        }
        let mut request = sample.into_value();
        let client = if is_cyclone {
            let Some(header) = request.split_header() else {
                let mut account = self.reading.shared.account();
                return account.count(name, Reason::NotCdr, "a request");
            };
            Client::Header(header)
        } else {
            Client::Sample(identity)
        };
        self.reading.ask(Asked { service, client, request }, name);
    }

    /// Handles an event of discovery.
    fn heed(&self, event: DomainParticipantStatusEvent, seen: &mut HashSet<GUID>) {
        use DomainParticipantStatusEvent as Event;
        match event {
            Event::WriterDetected { writer } => {
                let is_new = seen.len() < MAX_ANNOUNCED && seen.insert(writer.guid);
                if is_new {
                    let topic = (writer.topic_name.as_str(), writer.type_name.as_str());
                    let Reading { routes, robots, shared, .. } = &self.reading;
                    announced(routes, robots, topic, &mut shared.account());
                }
            }
            Event::WriterLost { guid, .. } => {
                seen.remove(&guid);
            }
            Event::RemoteWriterQosIncompatible { local_reader: ours, .. }
            | Event::RemoteReaderQosIncompatible { local_writer: ours, .. } => {
                if let Some(topic) = self.endpoints.get(&ours) {
                    let mut account = self.reading.shared.account();
                    account.count(topic, Reason::IncompatibleQos, "a participant");
                }
            }
            _ => {}
        }
        self.reading.shared.log_news();
    }
}

/// The number of messages of a topic that are kept for readers that have not acknowledged them.
fn depth(write: &RosWrite, robots: usize) -> i32 {
    let (least, most) = WRITE_DEPTH;
    let depth = (LEASE_NS / write.every_ns).clamp(least, most);
    let (bytes, least) = MAX_DIAGNOSTICS;
    let most = match write.what {
        RosWhat::Diagnostics => (bytes / ((robots + 1) * STATUS_BYTES)) as u64,
        _ => most,
    };
    depth.min(most.max(least)) as i32
}

/// Returns when the connection has to end.
async fn closed(shared: &Shared) {
    while !shared.is_closed() {
        sleep(POLL_INTERVAL).await;
    }
}

/// Raises the limit of descriptors to the maximum of this process, because DDS needs several for
/// each topic. Limits its memory: a stranger's false number can make DDS allocate without end. Then
/// this process ends, and all others keep theirs.
fn limit_resources() {
    let Rlimit { maximum, .. } = getrlimit(Resource::Nofile);
    let all = Rlimit { current: maximum, maximum };
    if let Err(error) = setrlimit(Resource::Nofile, all) {
        tracing::warn!(%error, "the limit of file descriptors is not raised");
    }
    let Rlimit { current, maximum } = getrlimit(Resource::Data);
    let less = Some(current.unwrap_or(u64::MAX).min(MAX_DATA_BYTES));
    if let Err(error) = setrlimit(Resource::Data, Rlimit { current: less, maximum }) {
        tracing::warn!(%error, "memory is not limited");
    }
}
