//! The connection to a broker, served by one thread.
//!
//! The thread subscribes after each connection, because a broker that was killed may have lost its
//! subscriptions. It reads messages, and sends those that others hand to its [`Outlet`]. Its memory
//! is bounded, whatever the broker sends.

mod connection;
mod inbox;
mod outlet;
mod sink;
mod transport;

use std::io;
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::thread;
use std::time::Duration;

use joulebus_bus::clock;
use joulebus_program::output::log_line;
use mqtt5_protocol::{Packet, QoS, ReasonCode};
use rustix::event::Timespec;

use crate::config::{MqttSettings, VERSIONS};
use crate::mapping::account::Reason;
use crate::mapping::outgoing::What;
use crate::mapping::robots::Robots;
use crate::mapping::route::{Message, Reader};
use crate::shared::Shared;
use connection::{Connection, Lost, after_ns, reason};
use inbox::Incoming;
use transport::Transport;

pub(crate) use outlet::{Outgoing, Outlet};
pub(crate) use sink::{AlarmReading, MAX_WAITING, MqttSink, Start};

/// Delay before the next attempt to connect: the first one, and the maximum. It doubles with each
/// attempt, and begins anew after a connection that lasted as long as the maximum.
const RETRY_DELAYS: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(10));
/// Delay until a stop is noticed.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
/// Timeout of the disconnection.
const DISCONNECT_TIMEOUT: Duration = Duration::from_secs(2);

/// Reason that the connection was given up: what is wrong at the start stays wrong.
#[derive(Debug, thiserror::Error)]
#[error("no connection to the broker {broker}: {why}")]
pub(crate) struct MqttError {
    broker: String,
    why: Lost,
}

/// A connection to a broker that reconnects after each loss.
pub(crate) struct Mqtt {
    broker: String,
    settings: MqttSettings,
    version: u8,
    /// True if the broker has answered by the newer version.
    knows_newer: bool,
    outlet: Arc<Outlet>,
    reader: Reader,
    /// The topics to subscribe to.
    filters: Vec<String>,
    /// Messages that are sent at the end. The broker sends the first of them if the bridge dies.
    goodbye: Vec<Outgoing>,
    shared: Arc<Shared>,
}

impl Mqtt {
    /// Prepares the connection. [`Mqtt::run`] opens it.
    pub(crate) fn new(
        settings: &MqttSettings,
        robots: &Robots,
        offline: &[u8],
        shared: &Arc<Shared>,
    ) -> io::Result<Self> {
        let statuses = settings.writes.iter();
        let statuses = statuses.filter(|write| write.what == What::Status);
        let goodbye = statuses.map(|write| Outgoing {
            topic: write.topic.of(""),
            payload: offline.to_vec(),
            qos: QoS::AtLeastOnce,
            retain: write.retain,
            expires_s: None,
        });
        let reader =
            Reader::new(settings.routes.clone(), robots.clone(), settings.max_payload_bytes);
        let capacity = 1_000 + 4 * robots.len() * settings.writes.len().max(1);
        Ok(Self {
            broker: format!("{}:{}", settings.host, settings.port),
            version: settings.version.unwrap_or(VERSIONS[1]),
            knows_newer: false,
            outlet: Arc::new(Outlet::new(capacity)?),
            filters: reader.filters(),
            reader,
            goodbye: goodbye.collect(),
            settings: settings.clone(),
            shared: Arc::clone(shared),
        })
    }

    /// The sending end of the connection.
    pub(crate) fn outlet(&self) -> Arc<Outlet> {
        Arc::clone(&self.outlet)
    }

    /// Connects, reads and sends until the bridge stops.
    pub(crate) fn run(mut self) -> Result<(), MqttError> {
        let ended = self.keep_connected();
        // Nobody takes what is left.
        while self.outlet.take().is_some() {
            self.outlet.count_lost();
        }
        ended
    }

    fn keep_connected(&mut self) -> Result<(), MqttError> {
        let mut pause = RETRY_DELAYS.0;
        loop {
            let began_ns = clock::monotonic_ns();
            let ended = self.connect().and_then(|mut connection| {
                let served = self.serve(&mut connection);
                served.inspect(|()| self.leave(&mut connection))
            });
            self.shared.log_news();
            let was_connected = self.outlet.disconnected();
            let why = match ended {
                Err(why) if !self.shared.is_closed() => why,
                _ => return Ok(()),
            };
            let broker = &self.broker;
            if self.settings.version.is_none() {
                let [older, newer] = VERSIONS;
                // A broker that restarts also closes: the next attempt is by the newer one again.
                let falls_back = self.version == newer && why.is_of_version(self.knows_newer);
                self.version = if falls_back { older } else { newer };
                if falls_back {
                    log_line(&format!(
                        "not connected to {broker} by MQTT 5: {why}, trying MQTT 3.1.1"
                    ));
                    continue;
                }
            }
            let may_ask_less = self.goodbye.iter().any(|message| message.qos != QoS::AtMostOnce);
            if why.is_of_qos() && may_ask_less {
                log_line(&format!("{broker} has QoS 0 alone: its messages are not acknowledged"));
                self.goodbye.iter_mut().for_each(|message| message.qos = QoS::AtMostOnce);
                continue;
            }
            if why.is_permanent() && !was_connected {
                let broker = broker.clone();
                return Err(MqttError { broker, why });
            }
            log_line(&format!("not connected to {broker}: {why}, trying again"));
            if clock::monotonic_ns() - began_ns > RETRY_DELAYS.1.as_nanos() as u64 {
                pause = RETRY_DELAYS.0;
            }
            let until_ns = after_ns(pause);
            while clock::monotonic_ns() < until_ns && !self.shared.is_closed() {
                thread::sleep(POLL_INTERVAL);
            }
            pause = (pause * 2).min(RETRY_DELAYS.1);
        }
    }

    fn connect(&self) -> Result<Connection, Lost> {
        let socket = self.open()?;
        // Read again for each connection, since certificates are renewed.
        let tls = self.settings.tls.as_ref().map(|tls| tls.load());
        let tls = tls.transpose().map_err(|(key, error)| Lost::File { key, error })?;
        let transport = Transport::new(socket, &self.settings.host, tls)?;
        Connection::new(transport, &self.settings, self.version, self.goodbye.first())
    }

    /// Opens a connection in a thread of its own, because looking a name up blocks.
    fn open(&self) -> Result<TcpStream, Lost> {
        let (opened, opens) = sync_channel(1);
        let (host, port) = (self.settings.host.clone(), self.settings.port);
        thread::Builder::new()
            .name("joulebus-open".to_owned())
            .spawn(move || opened.send(transport::open(&host, port)))?;
        loop {
            match opens.recv_timeout(POLL_INTERVAL) {
                Ok(socket) => return Ok(socket?),
                Err(RecvTimeoutError::Timeout) if !self.shared.is_closed() => {}
                Err(_) => return Err(Lost::Unanswered),
            }
        }
    }

    /// Serves a connection until it is lost. Returns when it has to end.
    fn serve(&mut self, connection: &mut Connection) -> Result<(), Lost> {
        while !self.shared.is_closed() {
            self.send(connection);
            connection.poll(&self.outlet, &POLL_TIMEOUT)?;
            while let Some(incoming) = connection.next()? {
                self.incoming(connection, incoming)?;
            }
            connection.ping()?;
            self.shared.log_news();
        }
        Ok(())
    }

    /// Sends what others have handed over. Returns whether that was all.
    fn send(&self, connection: &mut Connection) -> bool {
        while connection.has_room() {
            let Some(message) = self.outlet.take() else {
                return true;
            };
            self.publish(connection, message);
        }
        false
    }

    fn publish(&self, connection: &mut Connection, message: Outgoing) {
        if let Err(topic) = connection.publish(message) {
            self.outlet.count_lost();
            self.count(Reason::TooLong, &topic);
        }
    }

    fn count(&self, reason: Reason, name: &str) {
        self.shared.account().count("mqtt", reason, name);
    }

    fn incoming(&mut self, connection: &mut Connection, incoming: Incoming) -> Result<(), Lost> {
        match incoming {
            Incoming::Packet(Packet::ConnAck(answer)) if !connection.is_up() => {
                let is_unknown = answer.reason_code == ReasonCode::UnsupportedProtocolVersion;
                self.knows_newer |= self.version == VERSIONS[1] && !is_unknown;
                connection.accepted(&answer)?;
                log_line(&format!("connected to {}", self.broker));
                if !self.filters.is_empty() {
                    connection.subscribe(&self.filters)?;
                }
                self.outlet.connected();
            }
            Incoming::Packet(Packet::SubAck(answer)) => {
                for (filter, code) in self.filters.iter().zip(&answer.reason_codes) {
                    if !code.is_success() {
                        let reason = reason(code, &answer.properties);
                        self.count(Reason::Refused, &format!("reading {filter}: {reason}"));
                    }
                }
            }
            Incoming::Packet(Packet::PubAck(answer)) => {
                let topic = connection.acknowledged(answer.packet_id);
                if let (Some(topic), true) = (topic, answer.reason_code.is_error()) {
                    let reason = reason(answer.reason_code, &answer.properties);
                    self.count(Reason::Refused, &format!("writing {topic}: {reason}"));
                }
            }
            Incoming::Packet(Packet::Disconnect(packet)) => {
                let (code, reason) =
                    (packet.reason_code, reason(packet.reason_code, &packet.properties));
                return Err(match code {
                    ReasonCode::Success => Lost::Closed,
                    _ => Lost::Ended { code, reason },
                });
            }
            Incoming::Packet(Packet::Publish(publish)) => {
                self.shared.count_message();
                let message = Message {
                    topic: &publish.topic_name,
                    payload: &publish.payload,
                    retained: publish.retain,
                    unix_s: clock::unix_ns() as f64 * 1e-9,
                };
                let at_ns = clock::monotonic_ns();
                let (shared, mut account) = (&self.shared, self.shared.account());
                self.reader.read(message, &mut account, |robot, seen| {
                    shared.intake().take(robot, seen, at_ns);
                });
            }
            Incoming::TooLong { topic } => self.skip(Reason::TooLong, &topic),
            Incoming::Malformed { topic } => self.skip(Reason::WrongEncoding, &topic),
            Incoming::Packet(_) => {}
        }
        Ok(())
    }

    /// Counts a message that was not read.
    fn skip(&self, reason: Reason, topic: &str) {
        self.shared.count_message();
        self.reader.skip(topic, reason, &mut self.shared.account());
    }

    /// Sends what others have handed over, publishes that the bridge is offline, and disconnects.
    fn leave(&mut self, connection: &mut Connection) {
        if !connection.is_up() {
            return;
        }
        let until_ns = after_ns(DISCONNECT_TIMEOUT);
        let (mut is_published, mut is_closed) = (false, false);
        while clock::monotonic_ns() < until_ns {
            if self.send(connection) && !is_published {
                is_published = true;
                for message in std::mem::take(&mut self.goodbye) {
                    self.publish(connection, message);
                }
                connection.disconnect();
            }
            // The broker ends the connection once it has read all.
            let turned = connection.poll(&self.outlet, &POLL_TIMEOUT);
            let read = turned.and_then(|()| {
                while let Some(incoming) = connection.next()? {
                    self.incoming(connection, incoming)?;
                }
                Ok(())
            });
            if read.is_err() {
                return;
            }
            if is_published && connection.is_sent() && !is_closed {
                is_closed = true;
                connection.close();
            }
        }
    }
}

const POLL_TIMEOUT: Timespec = Timespec { tv_sec: 0, tv_nsec: POLL_INTERVAL.subsec_nanos() as i64 };
