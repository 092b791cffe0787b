//! The connection to a broker, served by one thread.
//!
//! The thread subscribes after each connection, because a broker that was killed may have lost its
//! subscriptions. It reads messages, and sends those that others hand to its [`Outlet`].

mod outlet;
mod sink;

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use joulebus_bus::clock;
use joulebus_program::output::say;
use rumqttc::mqttbytes::v4::{ConnectReturnCode, Packet, SubscribeFilter, SubscribeReasonCode};
use rumqttc::{AsyncClient, ConnectionError, Event, EventLoop, LastWill, MqttOptions, QoS};
use tokio::time::{MissedTickBehavior, interval, sleep, timeout};

use crate::config::{MqttSettings, Write};
use crate::mapping::account::Reason;
use crate::mapping::outgoing::What;
use crate::mapping::robots::Robots;
use crate::mapping::route::{Message, Reader};
use crate::shared::Shared;

pub(crate) use outlet::Outlet;
pub(crate) use sink::{MAX_WAITING, MqttSink, Start, read_alarms};

/// Maximum size of a received packet, bytes. A longer one ends the connection. A payload above its
/// own limit is received, counted and skipped.
const MAX_PACKET_BYTES: usize = 16 << 20;
/// Delay before the next attempt to connect: the first one, and the maximum. It doubles with each
/// attempt.
const RETRY_DELAYS: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(10));
/// Delay until a stop is noticed.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
/// Timeout of the disconnection.
const DISCONNECT_TIMEOUT: Duration = Duration::from_secs(2);

/// Why the connection was given up.
#[derive(Debug, thiserror::Error)]
pub(crate) enum MqttError {
    /// A login that is wrong at the start stays wrong.
    #[error(
        "the broker {broker} refuses the connection: {code:?}. Check `username`, `password_file` and `client_id`"
    )]
    Login {
        broker: String,
        code: ConnectReturnCode,
    },
    #[error("cannot start the connection's runtime: {0}")]
    Runtime(#[from] std::io::Error),
}

/// A connection to a broker that reconnects after each loss.
pub(crate) struct Mqtt {
    broker: String,
    client: AsyncClient,
    events: EventLoop,
    outlet: Arc<Outlet>,
    reader: Arc<Mutex<Reader>>,
    ask_every: Option<Duration>,
    /// Topic, payload, and whether the broker retains it.
    goodbye: Vec<(String, Vec<u8>, bool)>,
    shared: Arc<Shared>,
}

impl Mqtt {
    /// Prepares the connection. [`Mqtt::run`] opens it.
    pub(crate) fn new(
        settings: &MqttSettings,
        robots: &Robots,
        offline: &[u8],
        shared: &Arc<Shared>,
    ) -> Self {
        let mut options = MqttOptions::new(&settings.client_id, &settings.host, settings.port);
        options.set_keep_alive(settings.keep_alive);
        // No persistent session: messages queued for an absent bridge would be old.
        options.set_clean_session(true);
        options.set_max_packet_size(MAX_PACKET_BYTES, MAX_PACKET_BYTES);
        if let Some((username, password)) = &settings.login {
            options.set_credentials(username, password);
        }
        let is_status = |write: &&Write| write.what == What::Status;
        let goodbye: Vec<(String, Vec<u8>, bool)> = settings
            .writes
            .iter()
            .filter(is_status)
            .map(|write| (write.topic.of(""), offline.to_vec(), write.retain))
            .collect();
        if let Some((topic, payload, retain)) = goodbye.first() {
            let (qos, payload) = (QoS::AtLeastOnce, payload.clone());
            options.set_last_will(LastWill::new(topic, payload, qos, *retain));
        }
        let capacity = 1_000 + 4 * robots.len() * settings.writes.len().max(1);
        let (client, events) = AsyncClient::new(options, capacity);
        let mut reader = Reader::new(
            settings.routes.clone(),
            robots.clone(),
            settings.max_payload_bytes,
        );
        if let Some(vizier) = &settings.vizier {
            reader = reader.with_vizier(&settings.client_id, vizier.fields.clone());
        }
        Self {
            broker: format!("{}:{}", settings.host, settings.port),
            outlet: Arc::new(Outlet::new(client.clone())),
            client,
            events,
            reader: Arc::new(Mutex::new(reader)),
            ask_every: settings.vizier.as_ref().map(|vizier| vizier.every),
            goodbye,
            shared: Arc::clone(shared),
        }
    }

    /// The sending end of the connection.
    pub(crate) fn outlet(&self) -> Arc<Outlet> {
        Arc::clone(&self.outlet)
    }

    /// Connects, reads and sends until the bridge stops.
    ///
    /// # Errors
    /// [`MqttError`].
    pub(crate) fn run(self) -> Result<(), MqttError> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()?;
        runtime.block_on(self.serve())
    }

    async fn serve(mut self) -> Result<(), MqttError> {
        if let Some(every) = self.ask_every {
            tokio::spawn(ask(
                every,
                Arc::clone(&self.reader),
                Arc::clone(&self.outlet),
                Arc::clone(&self.shared),
            ));
        }
        let mut pause = RETRY_DELAYS.0;
        let shared = Arc::clone(&self.shared);
        loop {
            // The poll is cancelled only at the end, because cancelling it would lose a connection
            // that is being made.
            let event = tokio::select! {
                event = self.events.poll() => event,
                () = closed(&shared) => break,
            };
            match event {
                Ok(Event::Incoming(packet)) => {
                    if let Packet::ConnAck(_) = packet {
                        pause = RETRY_DELAYS.0;
                    }
                    self.incoming(packet);
                }
                Ok(Event::Outgoing(_)) => {}
                Err(error) => {
                    self.lost(&error)?;
                    tokio::select! {
                        () = sleep(pause) => pause = (pause * 2).min(RETRY_DELAYS.1),
                        () = closed(&shared) => break,
                    }
                }
            }
        }
        self.leave().await;
        Ok(())
    }

    fn incoming(&mut self, packet: Packet) {
        match packet {
            Packet::ConnAck(_) => {
                say(&format!("connected to {}", self.broker));
                self.subscribe();
                self.outlet.connected();
            }
            Packet::SubAck(answer) => {
                let refused = answer
                    .return_codes
                    .iter()
                    .filter(|code| **code == SubscribeReasonCode::Failure);
                if refused.count() > 0 {
                    self.shared
                        .account()
                        .count("mqtt", Reason::Refused, "a subscription");
                }
            }
            Packet::Publish(publish) => {
                self.shared.count_message();
                let message = Message {
                    topic: &publish.topic,
                    payload: &publish.payload,
                    retained: publish.retain,
                };
                let at_ns = clock::monotonic_ns();
                let (shared, mut account) = (&self.shared, self.shared.account());
                let mut reader = self.reader.lock().unwrap_or_else(PoisonError::into_inner);
                reader.read(message, &mut account, |robot, seen| {
                    shared.intake().take(robot, seen, at_ns);
                });
            }
            _ => {}
        }
        self.shared.log_news();
    }

    fn subscribe(&self) {
        let filters = self
            .reader
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .filters();
        if filters.is_empty() {
            return;
        }
        let filters = filters
            .into_iter()
            .map(|path| SubscribeFilter::new(path, QoS::AtMostOnce));
        if let Err(error) = self.client.try_subscribe_many(filters) {
            // Every new connection empties the queue.
            say(&format!("cannot subscribe: {error}"));
        }
    }

    fn lost(&self, error: &ConnectionError) -> Result<(), MqttError> {
        let was_connected = self.outlet.disconnected();
        if let ConnectionError::ConnectionRefused(code) = error
            && !was_connected
            && *code != ConnectReturnCode::ServiceUnavailable
        {
            return Err(MqttError::Login {
                broker: self.broker.clone(),
                code: *code,
            });
        }
        say(&format!(
            "not connected to {}: {error}; trying again",
            self.broker
        ));
        Ok(())
    }

    /// Publishes that the bridge is offline, and disconnects.
    async fn leave(&mut self) {
        if !self.outlet.is_connected() {
            return;
        }
        for (topic, payload, retain) in std::mem::take(&mut self.goodbye) {
            let _ = self
                .client
                .try_publish(topic, QoS::AtLeastOnce, retain, payload);
        }
        let _ = self.client.try_disconnect();
        let polling = async {
            while !matches!(
                self.events.poll().await,
                Err(_) | Ok(Event::Outgoing(rumqttc::Outgoing::Disconnect))
            ) {}
        };
        let _ = timeout(DISCONNECT_TIMEOUT, polling).await;
    }
}

/// Returns when the connection has to end.
async fn closed(shared: &Shared) {
    while !shared.is_closed() {
        sleep(POLL_INTERVAL).await;
    }
}

/// Sends the vizier's requests periodically.
async fn ask(
    every: Duration,
    reader: Arc<Mutex<Reader>>,
    outlet: Arc<Outlet>,
    shared: Arc<Shared>,
) {
    let mut due = interval(every);
    due.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        due.tick().await;
        if !outlet.is_connected() {
            continue;
        }
        let requests = {
            let mut account = shared.account();
            let mut reader = reader.lock().unwrap_or_else(PoisonError::into_inner);
            reader.requests(&mut account)
        };
        for (topic, body) in requests {
            // A request without room is repeated in the next round.
            outlet.write(topic, body.to_string().into_bytes(), QoS::AtMostOnce, false);
        }
        shared.log_news();
    }
}
