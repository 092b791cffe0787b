//! A real Mosquitto, and a client of it.

use std::fs;
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use joulebus_testkit::{Child, eventually, free_port};
use rumqttc::{Client, Event, MqttOptions, Packet, QoS};
use serde_json::Value;

/// The broker's program, as `tools/mosquitto.sh` prints it; `None` where it is missing, which is said aloud.
pub(crate) fn mosquitto() -> Option<PathBuf> {
    let named = std::env::var_os("JOULEBUS_MOSQUITTO").filter(|named| !named.is_empty());
    let usual = || {
        let folders = ["/usr/sbin", "/usr/local/sbin", "/usr/bin"];
        let programs = folders
            .iter()
            .map(|folder| Path::new(folder).join("mosquitto"));
        programs.into_iter().find(|program| program.exists())
    };
    let found = named.map(PathBuf::from).or_else(usual);
    if found.is_none() {
        eprintln!("skipped: there is no mosquitto (apt-get install mosquitto)");
        assert_ne!(
            std::env::var("CI").as_deref(),
            Ok("true"),
            "mosquitto is missing"
        );
    }
    found
}

pub(crate) struct Broker {
    program: PathBuf,
    port: u16,
    folder: tempfile::TempDir,
    child: Child,
}

impl Broker {
    /// Starts one on a free port; `more` are lines of its config.
    pub(crate) fn start(program: &Path, more: &str) -> Self {
        let port = free_port();
        let folder = tempfile::tempdir().unwrap();
        let text = format!(
            "listener {port} 127.0.0.1\npersistence false\nmax_queued_messages 100000\nuser root\n{more}\n"
        );
        fs::write(folder.path().join("mosquitto.conf"), text).unwrap();
        let child = spawn(program, folder.path(), port);
        Self {
            program: program.to_owned(),
            port,
            folder,
            child,
        }
    }

    pub(crate) fn address(&self) -> String {
        format!("127.0.0.1:{}", self.port)
    }

    pub(crate) fn file(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Kills it: what it kept is gone.
    pub(crate) fn kill(&mut self) {
        self.child.kill();
    }

    /// Starts it again at the same port.
    pub(crate) fn restart(&mut self) {
        self.child = spawn(&self.program, self.folder.path(), self.port);
    }

    /// A client that hears the topics of `filter`.
    pub(crate) fn client(&self, name: &str, filter: &str) -> Listener {
        let mut options = MqttOptions::new(name, "127.0.0.1", self.port);
        options.set_keep_alive(Duration::from_secs(5));
        options.set_max_packet_size(64 << 20, 64 << 20);
        let (client, mut connection) = Client::new(options, 10_000);
        let heard = Arc::<Mutex<Vec<Heard>>>::default();
        let (into, again, filter) = (Arc::clone(&heard), client.clone(), filter.to_owned());
        let ready = Arc::<Mutex<bool>>::default();
        let is_ready = Arc::clone(&ready);
        std::thread::spawn(move || {
            for event in connection.iter() {
                match event {
                    Ok(Event::Incoming(Packet::ConnAck(_))) => {
                        again.try_subscribe(&filter, QoS::AtMostOnce).unwrap();
                    }
                    Ok(Event::Incoming(Packet::SubAck(_))) => *is_ready.lock().unwrap() = true,
                    Ok(Event::Incoming(Packet::Publish(publish))) => {
                        into.lock().unwrap().push(Heard {
                            topic: publish.topic,
                            payload: publish.payload.to_vec(),
                            retained: publish.retain,
                        });
                    }
                    Ok(_) => {}
                    Err(rumqttc::ConnectionError::RequestsDone) => return,
                    Err(_) => std::thread::sleep(Duration::from_millis(50)),
                }
            }
        });
        eventually("a subscription", || *ready.lock().unwrap());
        Listener { client, heard }
    }
}

fn spawn(program: &Path, folder: &Path, port: u16) -> Child {
    let mut command = Command::new(program);
    command.arg("-c").arg(folder.join("mosquitto.conf"));
    let child = Child::spawn("mosquitto", command);
    eventually("a broker", || {
        TcpStream::connect(("127.0.0.1", port)).is_ok()
    });
    child
}

/// A message that was heard.
#[derive(Debug, Clone)]
pub(crate) struct Heard {
    pub(crate) topic: String,
    pub(crate) payload: Vec<u8>,
    pub(crate) retained: bool,
}

impl Heard {
    pub(crate) fn json(&self) -> Value {
        serde_json::from_slice(&self.payload).unwrap_or(Value::Null)
    }
}

pub(crate) struct Listener {
    pub(crate) client: Client,
    heard: Arc<Mutex<Vec<Heard>>>,
}

impl Listener {
    pub(crate) fn send(&self, topic: &str, payload: impl Into<Vec<u8>>) {
        self.client
            .publish(topic, QoS::AtMostOnce, false, payload)
            .unwrap();
    }

    pub(crate) fn heard(&self) -> Vec<Heard> {
        self.heard.lock().unwrap().clone()
    }

    pub(crate) fn forget(&self) {
        self.heard.lock().unwrap().clear();
    }

    /// Waits for a message of a topic that `is_it`.
    pub(crate) fn wait_for(&self, topic: &str, mut is_it: impl FnMut(&Value) -> bool) -> Heard {
        let mut found = None;
        eventually(topic, || {
            let heard = self.heard();
            found = heard
                .into_iter()
                .rev()
                .find(|heard| heard.topic == topic && is_it(&heard.json()));
            found.is_some()
        });
        found.unwrap()
    }
}
