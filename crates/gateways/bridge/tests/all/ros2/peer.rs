//! A participant of another vendor's DDS: Eclipse Cyclone DDS from PyPI.

use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::process::Command;

use joulebus_ros_messages::type_hash;
use joulebus_testkit::{Child, PATIENCE, eventually};
use rustix::process::Signal;
use serde_json::{Value, json};

/// Messages stay on this host, and discovery uses no multicast.
const CYCLONE: &str = r#"<CycloneDDS><Domain id="any">
    <General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces><AllowMulticast>false</AllowMulticast></General>
    <Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>20</MaxAutoParticipantIndex>
    <LeaseDuration>5s</LeaseDuration><Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>"#;

/// The Python that `tools/cyclonedds.sh` prints. `None` if it is missing, which is logged.
pub(crate) fn cyclonedds() -> Option<PathBuf> {
    let named = std::env::var_os("JOULEBUS_CYCLONEDDS").filter(|named| !named.is_empty());
    let program = named.map_or_else(|| PathBuf::from("python3"), PathBuf::from);
    let mut check = Command::new(&program);
    check.args(["-c", "import cyclonedds.domain, zenoh"]);
    let is_there = check.output().is_ok_and(|output| output.status.success());
    if !is_there {
        eprintln!("skipped: there is no cyclonedds (JOULEBUS_CYCLONEDDS=$(tools/cyclonedds.sh))");
        assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "cyclonedds is missing");
    }
    is_there.then_some(program)
}

/// The Python with ROS 2 that `tools/ros2.sh` prints. `None` if it is missing, which is logged.
pub(crate) fn ros2() -> Option<PathBuf> {
    let named = std::env::var_os("JOULEBUS_ROS2").filter(|named| !named.is_empty());
    if named.is_none() {
        eprintln!("skipped: there is no ROS 2 (JOULEBUS_ROS2=$(tools/ros2.sh))");
        assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "ROS 2 is missing");
    }
    named.map(PathBuf::from)
}

/// The hash of the definition of a type, which is named without its package.
pub(crate) fn hash(kind: &str) -> String {
    const PACKAGES: [&str; 8] = [
        "sensor_msgs/msg",
        "geometry_msgs/msg",
        "nav_msgs/msg",
        "rosgraph_msgs/msg",
        "std_msgs/msg",
        "diagnostic_msgs/msg",
        "joulebus_msgs/msg",
        "joulebus_msgs/srv",
    ];
    let mut hashes = PACKAGES.iter().map(|package| type_hash(&format!("{package}/{kind}")));
    hashes.find(|hash| hash.starts_with("RIHS01_")).unwrap_or_else(|| type_hash(kind))
}

/// A ROS 2 domain that no other test on this host uses. The test holds one of its ports, which DDS
/// does not use for so few participants.
pub(crate) struct RosDomain {
    pub(crate) id: u16,
    _held: UdpSocket,
}

impl RosDomain {
    pub(crate) fn take() -> Self {
        // Below the ephemeral ports of the kernel.
        let free = (1..=100).find_map(|id: u16| {
            let socket = UdpSocket::bind(("127.0.0.1", 7_400 + 250 * id + 249)).ok()?;
            Some(Self { id, _held: socket })
        });
        free.expect("a domain that no other test has")
    }

    /// The port on which discovery finds the first participant.
    pub(crate) fn first_port(&self) -> u16 {
        7_400 + 250 * self.id + 10
    }
}

pub(crate) struct Peer {
    child: Child,
}

impl Peer {
    /// Starts a participant in the domain.
    pub(crate) fn start(python: &Path, domain: &RosDomain) -> Self {
        Self::within(python, &domain.id.to_string())
    }

    /// Starts a participant: in a domain of DDS, or of zenoh at `tcp/host:port`.
    pub(crate) fn within(python: &Path, place: &str) -> Self {
        Self::run(python, "peer.py", place)
    }

    /// Starts a participant that connects to another one of zenoh at `tcp/host:port`.
    pub(crate) fn beside(python: &Path, address: &str) -> Self {
        Self::run(python, "peer.py", &address.replace("tcp/", "to/"))
    }

    /// Starts a node of ROS 2 in the domain.
    pub(crate) fn node(ros2: &Path, domain: &RosDomain) -> Self {
        Self::run(ros2, "node.py", &domain.id.to_string())
    }

    fn run(python: &Path, file: &str, place: &str) -> Self {
        let mut command = Command::new(python);
        command
            .arg(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/all/ros2")).join(file))
            .arg(place)
            .env("CYCLONEDDS_URI", CYCLONE)
            .env("PYTHONDONTWRITEBYTECODE", "1");
        let child = Child::spawn("peer", command);
        eventually("the peer is ready", || {
            child.lines(0, PATIENCE).iter().any(|line| line.contains("ready"))
        });
        Self { child }
    }

    /// Publishes a message 30 times a second, until another one of the topic.
    pub(crate) fn publish(&mut self, topic: &str, kind: &str, fields: &Value) {
        self.order(&json!({"say": topic, "type": kind, "fields": fields}));
    }

    pub(crate) fn subscribe(&mut self, topic: &str, kind: &str) {
        self.order(&json!({"hear": topic, "type": kind}));
    }

    /// Sends an order to `peer.py`, with the hash of its type if it names none.
    pub(crate) fn order(&mut self, order: &Value) {
        let mut order = order.clone();
        if let (None, Some(kind)) = (order.get("hash"), order["type"].as_str()) {
            order["hash"] = hash(kind).into();
        }
        self.child.send_line(&order.to_string());
    }

    /// Each message of the topic so far.
    pub(crate) fn each(&self, topic: &str, mut take: impl FnMut(&Value)) {
        for line in self.child.lines(0, PATIENCE) {
            let message: Value = serde_json::from_str(&line).unwrap();
            if message["topic"] == topic {
                take(&message["message"]);
            }
        }
    }

    /// The number of messages received so far, to wait from there.
    pub(crate) fn received(&self) -> usize {
        self.child.lines(0, PATIENCE).len()
    }

    /// Waits for a message of the topic for which `is_it` is true, after the first `from` messages.
    pub(crate) fn wait_for(
        &self,
        topic: &str,
        from: usize,
        mut is_it: impl FnMut(&Value) -> bool,
    ) -> Value {
        let (mut found, mut last, mut at) = (None, Value::Null, from);
        eventually(&format!("{topic}; its last: {}", self.last(topic)), || {
            let lines = self.child.lines(at, std::time::Duration::from_millis(50));
            at += lines.len();
            for line in lines {
                let message: Value = serde_json::from_str(&line).unwrap();
                if message["topic"] == topic {
                    last.clone_from(&message["message"]);
                    if is_it(&last) {
                        found = Some(last.clone());
                    }
                }
            }
            found.is_some()
        });
        found.unwrap()
    }

    fn last(&self, topic: &str) -> String {
        let lines = self.child.lines(0, PATIENCE);
        let last = lines.iter().rev().find(|line| line.contains(topic));
        last.cloned().unwrap_or_default()
    }

    pub(crate) fn signal(&mut self, signal: Signal) {
        self.child.signal(signal);
    }

    pub(crate) fn kill(&mut self) {
        self.child.kill();
    }
}
