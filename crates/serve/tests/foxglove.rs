//! The Foxglove server, as a client meets it.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

use std::fs;
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;
use std::thread;
use std::time::Duration;

use joulebus_capture::{Message, MessageKind};
use joulebus_config::Config;
use joulebus_predictor_worker::Worker;
use joulebus_publisher::{Pace, Publisher, RobotState};
use joulebus_test_processes::{Child, PATIENCE};
use rustix::process::Signal;
use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest as _;
use tungstenite::{Message as Frame, WebSocket};

/// A fleet whose worker and source are threads of the test.
struct Fleet {
    directory: tempfile::TempDir,
    config: Config,
}

impl Fleet {
    fn new() -> Self {
        let root = format!("/dev/shm/jbserve-{}", std::process::id());
        let text = format!(
            "[fleet]\nname = \"serve\"\ncapacity = 20\n\
             [domain]\nroot = \"{root}\"\nprefix = \"jbserve_\"\n\
             [intake]\nmax_sources = 4\n[readers]\nmax_planners = 4\n\
             [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-9\"]\n"
        );
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("fleet.toml");
        fs::write(&path, text).unwrap();
        let config = Config::load(path).unwrap();
        Self { directory, config }
    }

    fn path(&self) -> PathBuf {
        self.directory.path().join("fleet.toml")
    }

    /// Sends samples of three robots until `stop`.
    fn publish(&self, stop: &AtomicBool) {
        let mut publisher = Publisher::with_config(&self.config, "serve").unwrap();
        let mut pace = Pace::every(Duration::from_nanos(33_333_333));
        while !stop.load(Ordering::Relaxed) {
            pace.wait();
            let robots = (0..3).map(|id| RobotState::new(id).command(0.1, 0.2).reading(3.5));
            publisher.publish(robots).unwrap();
        }
    }

    /// What is left of it.
    fn stale_files(&self) -> Vec<PathBuf> {
        let prefix = self.config.domain().unwrap().shm_prefix().to_owned();
        let shared = fs::read_dir("/dev/shm").unwrap().flatten();
        let ours = shared.map(|entry| entry.path()).filter(|path| {
            let name = path.file_name().unwrap().to_string_lossy();
            name.starts_with(&prefix)
        });
        let root = self
            .config
            .root()
            .exists()
            .then(|| self.config.root().to_owned());
        ours.chain(root).collect()
    }
}

fn start(config: &Path) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_joulebus-serve"));
    command.args(["--foxglove", "--port", "0", "--format", "json", "--config"]);
    command.arg(config).env_remove("JOULEBUS_LOG");
    Child::spawn("serve", command)
}

fn connect(address: &str) -> WebSocket<TcpStream> {
    let stream = TcpStream::connect(address.strip_prefix("ws://").unwrap()).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let mut request = address.into_client_request().unwrap();
    let protocol = "foxglove.sdk.v1".parse().unwrap();
    request
        .headers_mut()
        .insert("sec-websocket-protocol", protocol);
    tungstenite::client(request, stream).unwrap().0
}

/// The next message that is JSON and of the kind `op`.
fn next_json(client: &mut WebSocket<TcpStream>, op: &str) -> Value {
    loop {
        if let Frame::Text(text) = client.read().unwrap() {
            let value: Value = serde_json::from_str(&text).unwrap();
            if value["op"] == op {
                return value;
            }
        }
    }
}

struct StopOnDrop<'a>(&'a AtomicBool);

impl Drop for StopOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

#[test]
fn a_client_sees_the_channels_and_a_message_it_can_decode() {
    let fleet = Fleet::new();
    let stop = AtomicBool::new(false);
    let (tell, told) = channel();
    thread::scope(|scope| {
        // Whatever happens, the threads end with the test.
        let _stopped = StopOnDrop(&stop);
        scope.spawn(|| {
            let mut worker = Worker::open(&fleet.config).unwrap();
            tell.send(()).unwrap();
            while !stop.load(Ordering::Relaxed) {
                worker.turn().unwrap();
            }
        });
        told.recv().unwrap();
        scope.spawn(|| fleet.publish(&stop));
        see_a_forecast(&fleet.path());
    });
    assert_eq!(fleet.stale_files(), Vec::<PathBuf>::new());
}

fn see_a_forecast(config: &Path) {
    let mut server = start(config);
    let line = server.says("serving fleet serve at ");
    let address = line.rsplit(' ').next().unwrap();
    assert!(address.starts_with("ws://127.0.0.1:"), "{address}");

    let mut client = connect(address);
    let info = next_json(&mut client, "serverInfo");
    assert_eq!(info["name"], "joulebus serve");
    let topic = MessageKind::Forecasts.topic("serve", 0);
    let channel = loop {
        let advertised = next_json(&mut client, "advertise");
        let channels = advertised["channels"].as_array().unwrap().clone();
        if let Some(channel) = channels
            .into_iter()
            .find(|channel| channel["topic"] == topic)
        {
            break channel;
        }
    };
    assert_eq!(channel["encoding"], "protobuf");
    assert_eq!(channel["schemaName"], MessageKind::Forecasts.schema());
    let subscribe = json!({
        "op": "subscribe",
        "subscriptions": [{ "id": 7, "channelId": channel["id"] }],
    });
    client.send(Frame::text(subscribe.to_string())).unwrap();
    let forecasts = loop {
        let Frame::Binary(bytes) = client.read().unwrap() else {
            continue;
        };
        // Opcode 1, our number, the log time, then the message as in a capture.
        if bytes[0] != 1 {
            continue;
        }
        assert_eq!(bytes[1..5], 7_u32.to_le_bytes());
        let Message::Forecasts(_, forecasts) =
            Message::decode(MessageKind::Forecasts, &bytes[13..]).unwrap()
        else {
            panic!("no forecasts");
        };
        if !forecasts.is_empty() {
            break forecasts;
        }
    };
    assert!(
        forecasts.iter().all(|forecast| forecast.robot < 3),
        "{forecasts:?}"
    );
    drop(client);

    server.signal(Signal::INT);
    let ended = server.wait();
    assert_eq!(ended.code(), Some(0), "{ended:?}");
    let report = ended.json();
    assert!(report["messages"].as_u64().unwrap() > 0, "{report}");
}
