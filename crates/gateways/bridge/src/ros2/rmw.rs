//! ROS 2's messages over zenoh, for robots on `rmw_zenoh_cpp`.
//!
//! The program `joulebus-link` has zenoh. `joulebus-link rmw-zenoh` runs as a child and carries the
//! messages. Frames on its stdin and stdout are described in its `rmw.rs`.

use std::collections::BTreeMap;
use std::io::{self, Read as _, Write as _};
use std::os::unix::process::CommandExt as _;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::{Arc, Mutex};

use joulebus_program::installed::find_program;
use joulebus_program::output::log_line;
use joulebus_ros_messages::{Clock, type_hash};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use serde_json::{Value, json};

use crate::config::Ros2Settings;
use crate::mapping::account::Reason;
use crate::mapping::ros::discovery::announced;
use crate::mapping::ros::incoming::{MAX_BYTES, Received};
use crate::mapping::ros::names::{dds_topic, dds_type, node_name, ros_type};
use crate::ros2::answering::Asked;
use crate::ros2::reading::{CLOCK_TOPIC, POLL_INTERVAL, Reading, Ros2Error};
use crate::ros2::sink::{RosSink, Topic};
use crate::ros2::writer::{Client, Writer, ZenohWriter};

/// Index of frames that are no message.
const NOTICE: u32 = u32::MAX;
/// Maximum size of a frame of the child: the number of a request, and a message. It shortens what
/// is longer than a message may be.
const MAX_FRAME_BYTES: usize = 8 + MAX_BYTES + 1;
/// The variable by which every ROS 2 program chooses its middleware.
const VARIABLE: &str = "RMW_IMPLEMENTATION";

/// True if ROS 2 is reached over zenoh, and not over DDS.
pub(crate) fn is_zenoh() -> bool {
    std::env::var(VARIABLE).is_ok_and(|name| name == "rmw_zenoh_cpp")
}

/// The running child, and the topics that it reads.
pub(crate) struct Zenoh {
    child: Child,
    /// Kept open, because the child ends with it: the sink may be dropped first.
    _input: Arc<Mutex<ChildStdin>>,
    output: ChildStdout,
    /// Bytes of frames that are not complete yet.
    buffer: Vec<u8>,
    /// Route and robot of each read topic.
    incoming: Vec<(usize, u32)>,
    /// Names of services. Their indices are the last.
    services: Vec<String>,
    /// True if the simulated clock is read. Its index follows those of the read topics.
    has_clock: bool,
    reading: Reading,
}

impl Zenoh {
    /// Starts the child and opens all topics and services, whose writers of responses it returns.
    ///
    /// # Errors
    /// There is no such program, or it has ended.
    pub(crate) fn open(
        settings: &Ros2Settings,
        reading: Reading,
        sink: &mut RosSink,
    ) -> Result<(Self, Vec<Writer>), Ros2Error> {
        let (mut incoming, mut read, mut write) = (Vec::new(), Vec::new(), Vec::new());
        for (place, route) in reading.routes.iter().enumerate() {
            for (robot, name) in reading.robots.iter() {
                incoming.push((place, robot));
                read.push(topic(&route.topic.of(name), ros_type(route.kind)));
            }
        }
        let has_clock = reading.shared.simulated().is_some();
        read.extend(has_clock.then(|| topic(CLOCK_TOPIC, Clock::NAME)));
        let mut topics: Vec<Vec<(u32, u32)>> = Vec::new();
        for wanted in &settings.writes {
            let of_robot = reading.robots.iter().filter(|_| wanted.what.is_of_robot());
            let of_fleet = (!wanted.what.is_of_robot()).then_some((0, ""));
            let mut places = Vec::new();
            for (robot, name) in of_robot.chain(of_fleet) {
                places.push((robot, write.len() as u32));
                let mut topic = topic(&wanted.topic.of(name), wanted.what.type_name());
                topic["kept"] = u8::from(wanted.what.is_latched()).into();
                write.push(topic);
            }
            topics.push(places);
        }
        let name = node_name(&sink.name);
        let node = json!({"domain_id": settings.domain_id, "name": name});
        let served = settings.services.iter();
        let serve: Vec<Value> =
            served.map(|(service, name)| topic(name, service.type_name())).collect();
        let asked = json!({"node": node, "read": read, "write": write, "serve": serve});
        let (child, input, output) = start(&asked).map_err(Ros2Error::Zenoh)?;
        let input = Arc::new(Mutex::new(input));
        let writer = |place| Writer::Zenoh(ZenohWriter { input: Arc::clone(&input), topic: place });
        sink.topics = settings
            .writes
            .iter()
            .zip(topics)
            .map(|(wanted, places)| {
                let writers = places.into_iter().map(|(robot, topic)| (robot, writer(topic)));
                Topic {
                    write: wanted.clone(),
                    writers: writers.collect::<BTreeMap<_, _>>(),
                    due_ns: 0,
                }
            })
            .collect();
        let repliers = (0..serve.len()).map(|place| writer((write.len() + place) as u32)).collect();
        let services = settings.services.iter().map(|(_, name)| name.clone()).collect();
        let mut zenoh = Self {
            child,
            _input: Arc::clone(&input),
            output,
            buffer: Vec::new(),
            incoming,
            services,
            has_clock,
            reading,
        };
        while zenoh.frame().is_none() {
            zenoh.receive()?;
        }
        log_line(&format!(
            "in ROS domain {} over zenoh as node /{name}: {} topics read, {} written, {} services",
            settings.domain_id,
            read.len(),
            write.len(),
            serve.len()
        ));
        Ok((zenoh, repliers))
    }

    /// Takes messages until the bridge stops.
    pub(crate) fn run(mut self) -> Result<(), Ros2Error> {
        let timeout = Timespec::try_from(POLL_INTERVAL).unwrap_or_default();
        while !self.reading.shared.is_closed() {
            let mut waiting = [PollFd::new(&self.output, PollFlags::IN)];
            if poll(&mut waiting, Some(&timeout)).is_ok_and(|ready| ready > 0) {
                self.receive()?;
            }
            while let Some((index, message)) = self.frame() {
                self.take(index, &message);
            }
        }
        Ok(())
    }

    /// Reads what the child has written, and waits for it.
    fn receive(&mut self) -> Result<(), Ros2Error> {
        let mut bytes = [0; 16_384];
        match self.output.read(&mut bytes) {
            Ok(0) => {
                let ended = self
                    .child
                    .wait()
                    .map_or_else(|error| error.to_string(), |status| status.to_string());
                Err(Ros2Error::Zenoh(anyhow::anyhow!("joulebus-link rmw-zenoh has ended: {ended}")))
            }
            Ok(count) => {
                self.buffer.extend_from_slice(&bytes[..count]);
                Ok(())
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => Ok(()),
            Err(error) => Err(Ros2Error::Zenoh(error.into())),
        }
    }

    /// The next whole frame.
    fn frame(&mut self) -> Option<(u32, Vec<u8>)> {
        let (head, rest) = self.buffer.split_first_chunk::<8>()?;
        let [index, length] = [&head[..4], &head[4..]]
            .map(|bytes| bytes.try_into().map_or(u32::MAX, u32::from_le_bytes));
        let message = rest.get(..(length as usize).min(MAX_FRAME_BYTES))?.to_vec();
        self.buffer.drain(..8 + message.len());
        Some((index, message))
    }

    fn take(&self, index: u32, message: &[u8]) {
        if index == NOTICE {
            let mut lines = std::str::from_utf8(message).unwrap_or_default().lines();
            if let (Some(topic), Some(kind)) = (lines.next(), lines.next()) {
                let topic = dds_topic(topic);
                let Reading { routes, robots, shared, .. } = &self.reading;
                announced(routes, robots, (&topic, kind), &mut shared.account());
                shared.log_news();
            }
            return;
        }
        let index = index as usize;
        if let Some(of) = self.incoming.get(index).copied() {
            return self.reading.take(of, received(message).as_ref(), Reason::NotCdr);
        }
        if self.has_clock && index == self.incoming.len() {
            return self.reading.take_clock(received(message).as_ref());
        }
        let service = index - self.incoming.len() - usize::from(self.has_clock);
        let request = message.split_first_chunk();
        let request = request.and_then(|(number, message)| Some((number, received(message)?)));
        if let (Some(name), Some((number, request))) = (self.services.get(service), request) {
            let client = Client::Query(u64::from_le_bytes(*number));
            self.reading.ask(Asked { service, client, request }, name);
        }
    }
}

impl Drop for Zenoh {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A topic or service as the child receives it.
fn topic(name: &str, kind: &str) -> Value {
    json!({"topic": name, "type": dds_type(kind), "hash": type_hash(kind)})
}

/// A message with its encapsulation header.
fn received(message: &[u8]) -> Option<Received> {
    let ([one, two, ..], body) = message.split_first_chunk::<4>()?;
    Some(Received::new([*one, *two], body))
}

fn start(asked: &Value) -> anyhow::Result<(Child, ChildStdin, ChildStdout)> {
    let mut child = Command::new(find_program("joulebus-link")?)
        .arg("rmw-zenoh")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        // Ctrl-C reaches the bridge alone, which ends the child.
        .process_group(0)
        .spawn()?;
    let pipes = child.stdin.take().zip(child.stdout.take());
    let (mut input, output) = pipes.ok_or_else(|| anyhow::anyhow!("no pipes"))?;
    writeln!(input, "{asked}")?;
    Ok((child, input, output))
}
