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

/// The broker's program, as `tools/mosquitto.sh` prints it. `None` if it is missing, which is
/// logged.
pub(crate) fn mosquitto() -> Option<PathBuf> {
    let named = std::env::var_os("JOULEBUS_MOSQUITTO").filter(|named| !named.is_empty());
    let usual = || {
        let folders = ["/usr/sbin", "/usr/local/sbin", "/usr/bin"];
        let programs = folders.iter().map(|folder| Path::new(folder).join("mosquitto"));
        programs.into_iter().find(|program| program.exists())
    };
    let found = named.map(PathBuf::from).or_else(usual);
    if found.is_none() {
        eprintln!("skipped: there is no mosquitto (apt-get install mosquitto)");
        assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "mosquitto is missing");
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
    /// Starts a broker on a free port. `more` has further lines of its config.
    pub(crate) fn start(program: &Path, more: &str) -> Self {
        let port = free_port();
        let folder = tempfile::tempdir().unwrap();
        let text = format!(
            "listener {port} 127.0.0.1\npersistence false\nmax_queued_messages 100000\nuser root\n{more}\n"
        );
        fs::write(folder.path().join("mosquitto.conf"), text).unwrap();
        let child = spawn(program, folder.path(), port);
        Self { program: program.to_owned(), port, folder, child }
    }

    pub(crate) fn address(&self) -> String {
        format!("127.0.0.1:{}", self.port)
    }

    pub(crate) fn file(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Kills the broker, which loses the retained messages.
    pub(crate) fn kill(&mut self) {
        self.child.kill();
    }

    /// Starts it again on the same port.
    pub(crate) fn restart(&mut self) {
        self.child = spawn(&self.program, self.folder.path(), self.port);
    }

    /// A client that subscribes to `filter`.
    pub(crate) fn client(&self, name: &str, filter: &str) -> Listener {
        let mut options = MqttOptions::new(name, "127.0.0.1", self.port);
        options.set_keep_alive(Duration::from_secs(5));
        options.set_max_packet_size(64 << 20, 64 << 20);
        let (client, mut connection) = Client::new(options, 10_000);
        let messages = Arc::<Mutex<Vec<Message>>>::default();
        let (into, again, filter) = (Arc::clone(&messages), client.clone(), filter.to_owned());
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
                        into.lock().unwrap().push(Message {
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
        Listener { client, messages }
    }
}

fn spawn(program: &Path, folder: &Path, port: u16) -> Child {
    let mut command = Command::new(program);
    command.arg("-c").arg(folder.join("mosquitto.conf"));
    let child = Child::spawn("mosquitto", command);
    eventually("a broker", || TcpStream::connect(("127.0.0.1", port)).is_ok());
    child
}

#[derive(Debug, Clone)]
pub(crate) struct Message {
    pub(crate) topic: String,
    pub(crate) payload: Vec<u8>,
    pub(crate) retained: bool,
}

impl Message {
    pub(crate) fn json(&self) -> Value {
        serde_json::from_slice(&self.payload).unwrap_or(Value::Null)
    }
}

pub(crate) struct Listener {
    pub(crate) client: Client,
    messages: Arc<Mutex<Vec<Message>>>,
}

impl Listener {
    pub(crate) fn send(&self, topic: &str, payload: impl Into<Vec<u8>>) {
        self.client.publish(topic, QoS::AtMostOnce, false, payload).unwrap();
    }

    pub(crate) fn messages(&self) -> Vec<Message> {
        self.messages.lock().unwrap().clone()
    }

    pub(crate) fn forget(&self) {
        self.messages.lock().unwrap().clear();
    }

    /// Waits for a message of the topic for which `is_it` is true.
    pub(crate) fn wait_for(&self, topic: &str, mut is_it: impl FnMut(&Value) -> bool) -> Message {
        let mut found = None;
        eventually(topic, || {
            let messages = self.messages();
            found = messages
                .into_iter()
                .rev()
                .find(|message| message.topic == topic && is_it(&message.json()));
            found.is_some()
        });
        found.unwrap()
    }
}
