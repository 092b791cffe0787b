//! One connection to a broker: packets in and out, acknowledgements and pings.

use std::collections::BTreeMap;
use std::fmt::{self, Debug};
use std::io::{self, ErrorKind};
use std::ops::Bound;
use std::time::Duration;

use joulebus_bus::clock;
use mqtt5_protocol::packet::MqttPacket;
use mqtt5_protocol::packet::connack::ConnAckPacket;
use mqtt5_protocol::packet::connect::ConnectPacket;
use mqtt5_protocol::packet::publish::PublishPacket;
use mqtt5_protocol::packet::subscribe::SubscribePacket;
use mqtt5_protocol::{
    MqttError, Properties, PropertyId, PropertyValue, QoS, ReasonCode, WillMessage,
};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustls::{AlertDescription, CertificateError, Error as TlsError, PeerIncompatible};

use crate::config::MqttSettings;
use crate::mqtt::inbox::{Inbox, Incoming};
use crate::mqtt::outlet::{Outgoing, Outlet};
use crate::mqtt::transport::Transport;

/// Maximum size of a packet that a broker of MQTT 5 is asked to send, bytes. It drops longer
/// messages without a report. Shorter ones that are too long are skipped and counted here.
const MAX_PACKET_BYTES: u32 = 16 << 20;
/// Bytes that are read at once, and after which no further message is encoded.
const CHUNK_BYTES: usize = 64 << 10;
/// Maximum number of messages that wait for their acknowledgement.
const MAX_UNACKNOWLEDGED: usize = 100;
/// Timeout of TLS and of the broker's answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(10);
/// Maximum length of the broker's own words in messages, letters.
const MAX_LETTERS: usize = 200;

const PING: [u8; 2] = [0xc0, 0];
const DISCONNECT: [u8; 2] = [0xe0, 0];
/// The first byte of an alert of TLS. No packet of a broker begins with it.
const TLS_ALERT: u8 = 0x15;

/// Reason that there is no connection.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Lost {
    #[error(transparent)]
    Io(#[from] io::Error),
    #[error("{error}. {}", tls_remedy(.error))]
    Tls { error: TlsError },
    #[error("the file of `mqtt.tls.{key}` {error}")]
    File { key: &'static str, error: String },
    /// Before the broker has answered.
    #[error(
        "it ended the connection without an answer. A port of TLS needs [mqtt.tls], \
         and a port without TLS none"
    )]
    Unanswered,
    #[error("it speaks TLS: add [mqtt.tls]")]
    SpeaksTls,
    #[error("it did not answer within {} s", ANSWER_TIMEOUT.as_secs())]
    NoAnswer,
    #[error("it refuses the connection: {reason}. {}", remedy(*.code))]
    Refused { code: ReasonCode, reason: String },
    #[error("it ended the connection (again and again: does another client have its `client_id`?)")]
    Closed,
    #[error("it ended the connection: {reason}. {}", remedy(*.code))]
    Ended { code: ReasonCode, reason: String },
    #[error("it has sent nothing for {} s", .0.as_secs())]
    Silent(Duration),
    #[error(
        "it answers, but has not acknowledged a message for {} s. Is it overloaded, or its disk \
         full? The broker's own log says more",
        .0.as_secs()
    )]
    Unacknowledged(Duration),
    #[error("it does not speak MQTT: {0}")]
    Malformed(#[from] MqttError),
}

impl Lost {
    /// True if another attempt with the same file would fail as well.
    pub(super) const fn is_permanent(&self) -> bool {
        match self {
            Self::Refused { code, .. } => !matches!(
                code,
                ReasonCode::ServerUnavailable
                    | ReasonCode::ServerBusy
                    | ReasonCode::ServerShuttingDown
                    | ReasonCode::QuotaExceeded
                    | ReasonCode::ConnectionRateExceeded
            ),
            Self::Tls { error } => {
                !matches!(error, TlsError::AlertReceived(AlertDescription::InternalError))
            }
            Self::File { .. } | Self::SpeaksTls => true,
            _ => false,
        }
    }

    /// True if the broker takes no message that it has to acknowledge.
    pub(super) const fn is_of_qos(&self) -> bool {
        matches!(self, Self::Refused { code: ReasonCode::QoSNotSupported, .. })
    }

    /// True if the broker may know another version of MQTT alone. Some end the connection without
    /// a word, which means nothing once a broker has answered by this version (`is_known`).
    pub(super) const fn is_of_version(&self, is_known: bool) -> bool {
        match self {
            Self::Unanswered => !is_known,
            Self::Refused { code, .. } => {
                matches!(code, ReasonCode::UnsupportedProtocolVersion)
            }
            _ => false,
        }
    }
}

const fn remedy(code: ReasonCode) -> &'static str {
    match code {
        ReasonCode::UnsupportedProtocolVersion => {
            "Set `mqtt.version` to one that the broker knows: \"5\" or \"3.1.1\""
        }
        ReasonCode::ClientIdentifierNotValid => "Set another `mqtt.client_id`",
        ReasonCode::SessionTakenOver => {
            "Another client has the same `mqtt.client_id`: each needs its own"
        }
        ReasonCode::UseAnotherServer | ReasonCode::ServerMoved => {
            "Name the other broker in `mqtt.broker`"
        }
        ReasonCode::RetainNotSupported => "Set `retain = false` at each `[[mqtt.write]]`",
        ReasonCode::BadUsernameOrPassword
        | ReasonCode::NotAuthorized
        | ReasonCode::Banned
        | ReasonCode::BadAuthenticationMethod => {
            "Check `username`, `password_file` and `client_id`, and the broker's rules for them"
        }
        _ => "The broker's own log says more",
    }
}

const fn tls_remedy(error: &TlsError) -> &'static str {
    use AlertDescription as Alert;
    use CertificateError as Certificate;
    match error {
        TlsError::InvalidCertificate(
            // The latter: of another authority of the same name.
            Certificate::UnknownIssuer | Certificate::BadSignature,
        ) => "`mqtt.tls.ca` needs the authority that the broker's certificate is of",
        TlsError::InvalidCertificate(
            Certificate::Expired
            | Certificate::ExpiredContext { .. }
            | Certificate::NotValidYet
            | Certificate::NotValidYetContext { .. },
        ) => "Renew the broker's certificate, or set the clock of this host",
        TlsError::InvalidCertificate(
            Certificate::NotValidForName | Certificate::NotValidForNameContext { .. },
        ) => "Name the broker in `mqtt.broker` as its certificate does",
        TlsError::AlertReceived(
            Alert::HandshakeFailure
            | Alert::NoCertificate
            | Alert::BadCertificate
            | Alert::UnsupportedCertificate
            | Alert::CertificateRevoked
            | Alert::CertificateExpired
            | Alert::CertificateUnknown
            | Alert::UnknownCA
            | Alert::AccessDenied
            | Alert::DecryptError
            | Alert::CertificateRequired,
        ) => {
            "The broker takes no connection without a valid `mqtt.tls.certificate` of its authority"
        }
        TlsError::AlertReceived(Alert::ProtocolVersion)
        | TlsError::PeerIncompatible(PeerIncompatible::ServerDoesNotSupportTls12Or13) => {
            "The broker needs TLS 1.2 or 1.3"
        }
        TlsError::AlertReceived(_) => "The broker's own log says more",
        TlsError::InvalidMessage(_) => "Is it a port of TLS? The usual one is 8883",
        _ => "Check [mqtt.tls]",
    }
}

/// A code as words, with the text of the broker.
pub(super) fn reason(code: impl Debug, properties: &Properties) -> String {
    let mut words = String::new();
    for letter in format!("{code:?}").replace("QoS", "Qos").chars() {
        if letter.is_uppercase() && !words.is_empty() {
            words.push(' ');
        }
        words.extend(letter.to_lowercase());
    }
    if let Some(PropertyValue::Utf8String(own)) = properties.get(PropertyId::ReasonString) {
        let own: String = own.chars().take(MAX_LETTERS).collect();
        words += &format!(" ({own})");
    }
    words
}

pub(super) struct Connection {
    transport: Transport,
    inbox: Inbox,
    version: u8,
    chunk: Vec<u8>,
    /// Encoded packets that are not sent yet.
    out: Vec<u8>,
    /// True if the broker has accepted the connection.
    is_up: bool,
    /// Topics of messages that the broker has not acknowledged.
    unacknowledged: BTreeMap<u16, String>,
    /// The oldest of them at the last ping, until it is acknowledged.
    waits: Option<u16>,
    last_id: u16,
    limits: Limits,
    keep_alive: Duration,
    ping_due_ns: u64,
    is_asked: bool,
    /// Bytes received since the last ping.
    received: usize,
}

/// Limits of the broker.
struct Limits {
    unacknowledged: usize,
    packet_bytes: usize,
    acknowledges: bool,
    retains: bool,
}

impl Debug for Connection {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("Connection").finish_non_exhaustive()
    }
}

impl Connection {
    /// Introduces the bridge to the broker. `will` is what the broker publishes if the bridge dies.
    pub(super) fn new(
        transport: Transport,
        settings: &MqttSettings,
        version: u8,
        will: Option<&Outgoing>,
    ) -> Result<Self, Lost> {
        let mut connection = Self {
            transport,
            inbox: Inbox::new(version, settings.max_payload_bytes),
            version,
            chunk: vec![0; CHUNK_BYTES],
            out: Vec::new(),
            is_up: false,
            unacknowledged: BTreeMap::new(),
            waits: None,
            last_id: 0,
            limits: Limits {
                unacknowledged: MAX_UNACKNOWLEDGED,
                packet_bytes: usize::MAX,
                acknowledges: true,
                retains: true,
            },
            keep_alive: settings.keep_alive,
            ping_due_ns: after_ns(ANSWER_TIMEOUT),
            is_asked: false,
            received: 0,
        };
        let mut properties = Properties::new();
        properties.set_maximum_packet_size(MAX_PACKET_BYTES);
        let (username, password) = settings.login.clone().unzip();
        ConnectPacket {
            protocol_version: version,
            // No persistent session: messages queued for an absent bridge would be old.
            clean_start: true,
            // At most 3,600 s.
            keep_alive: settings.keep_alive.as_secs() as u16,
            client_id: settings.client_id.clone(),
            username,
            password: password.map(String::into_bytes),
            will: will.map(|will| {
                WillMessage::new(&will.topic, will.payload.clone())
                    .with_qos(will.qos)
                    .with_retain(will.retain)
            }),
            properties,
            will_properties: Properties::new(),
        }
        .encode(&mut connection.out)?;
        Ok(connection)
    }

    pub(super) const fn is_up(&self) -> bool {
        self.is_up
    }

    /// Reads the broker's answer to the introduction.
    pub(super) fn accepted(&mut self, answer: &ConnAckPacket) -> Result<(), Lost> {
        let (code, found) = (answer.reason_code, &answer.properties);
        if code != ReasonCode::Success {
            let reason = reason(code, found);
            return Err(Lost::Refused { code, reason });
        }
        self.is_up = true;
        let most = usize::from(found.get_receive_maximum().unwrap_or(u16::MAX));
        let retains = found.get(PropertyId::RetainAvailable);
        self.limits = Limits {
            unacknowledged: most.clamp(1, MAX_UNACKNOWLEDGED),
            packet_bytes: found
                .get_maximum_packet_size()
                .map_or(usize::MAX, |bytes| bytes as usize),
            acknowledges: found.get_maximum_qos() != Some(0),
            retains: retains != Some(&PropertyValue::Byte(0)),
        };
        if let Some(found_s @ 1..) = found.get_server_keep_alive() {
            // Not longer than configured, so that a dead connection is noticed in time.
            self.keep_alive = self.keep_alive.min(Duration::from_secs(found_s.into()));
        }
        self.ping_due_ns = after_ns(self.keep_alive);
        Ok(())
    }

    pub(super) fn subscribe(&mut self, filters: &[String]) -> Result<(), Lost> {
        let mut packet = SubscribePacket::new(self.id());
        packet.protocol_version = self.version;
        for filter in filters {
            packet = packet.add_filter(filter, QoS::AtMostOnce);
        }
        Ok(packet.encode(&mut self.out)?)
    }

    /// True if a message can be sent now.
    pub(super) fn has_room(&self) -> bool {
        self.is_up
            && self.out.len() < CHUNK_BYTES
            && self.unacknowledged.len() < self.limits.unacknowledged
    }

    /// Sends a message, or returns the topic of one that the broker does not take.
    pub(super) fn publish(&mut self, message: Outgoing) -> Result<(), String> {
        let topic = message.topic.clone();
        let mut packet = PublishPacket::new(message.topic, message.payload, message.qos);
        packet.protocol_version = self.version;
        packet.retain = message.retain && self.limits.retains;
        if let Some(expires_s) = message.expires_s {
            packet.properties.set_message_expiry_interval(expires_s);
        }
        let id = (message.qos != QoS::AtMostOnce && self.limits.acknowledges).then(|| self.id());
        if id.is_none() {
            packet.qos = QoS::AtMostOnce;
        }
        packet.packet_id = id;
        let before = self.out.len();
        let encoded = packet.encode(&mut self.out);
        if encoded.is_err() || self.out.len() - before > self.limits.packet_bytes {
            self.out.truncate(before);
            return Err(topic);
        }
        self.unacknowledged.extend(id.map(|id| (id, topic)));
        Ok(())
    }

    /// The topic of a message that the broker has acknowledged.
    pub(super) fn acknowledged(&mut self, id: u16) -> Option<String> {
        self.waits.take_if(|waits| *waits == id);
        self.unacknowledged.remove(&id)
    }

    /// Sends the broker a disconnect.
    pub(super) fn disconnect(&mut self) {
        self.out.extend(DISCONNECT);
    }

    /// True if everything was handed to the network.
    pub(super) fn is_sent(&self) -> bool {
        self.out.is_empty() && !self.transport.wants_write()
    }

    /// Ends the sending direction.
    pub(super) fn close(&mut self) {
        self.transport.close();
    }

    /// Reads and writes what is possible, and waits up to `timeout` until something is.
    pub(super) fn poll(&mut self, outlet: &Outlet, timeout: &Timespec) -> Result<(), Lost> {
        let mut wanted = PollFlags::IN;
        wanted.set(PollFlags::OUT, !self.is_sent());
        let mut ready = [
            PollFd::new(self.transport.socket(), wanted),
            PollFd::new(outlet.wake(), PollFlags::IN),
        ];
        // A signal interrupts it: then nothing is ready.
        let _ = poll(&mut ready, Some(timeout));
        if !ready[1].revents().is_empty() {
            outlet.woken();
        }
        match self.transport.read(&mut self.chunk) {
            Ok(0) => return Err(self.ended()),
            Ok(count) => {
                let is_first = !self.is_up && self.received == 0;
                if is_first && self.chunk[0] == TLS_ALERT && !self.transport.is_tls() {
                    return Err(Lost::SpeaksTls);
                }
                self.received += count;
                self.inbox.add(&self.chunk[..count]);
            }
            Err(error) => match error.kind() {
                ErrorKind::WouldBlock | ErrorKind::Interrupted => {}
                ErrorKind::ConnectionReset | ErrorKind::BrokenPipe => return Err(self.ended()),
                _ => return Err(tls_or_io(error)),
            },
        }
        while !self.is_sent() {
            match self.transport.write(&self.out) {
                Ok(count) => drop(self.out.drain(..count)),
                // Where the connection has failed, reading returns the cause.
                Err(error) if error.kind() != ErrorKind::Interrupted => break,
                Err(_) => {}
            }
            if self.transport.wants_write() {
                break;
            }
        }
        Ok(())
    }

    /// The next packet of the broker.
    pub(super) fn next(&mut self) -> Result<Option<Incoming>, Lost> {
        let next = self.inbox.next()?;
        if next.is_some() {
            self.received += CHUNK_BYTES;
        }
        Ok(next)
    }

    const fn ended(&self) -> Lost {
        if self.is_up { Lost::Closed } else { Lost::Unanswered }
    }

    /// Asks the broker for an answer now and then. It is gone if it then sends neither a packet nor
    /// 64 KiB of a long one, or does not acknowledge. To be called once all packets were read.
    pub(super) fn ping(&mut self) -> Result<(), Lost> {
        if clock::monotonic_ns() < self.ping_due_ns {
            return Ok(());
        }
        if !self.is_up {
            return Err(Lost::NoAnswer);
        }
        if self.is_asked && self.received < CHUNK_BYTES {
            return Err(Lost::Silent(self.keep_alive));
        }
        if self.waits.is_some() {
            return Err(Lost::Unacknowledged(self.keep_alive));
        }
        // Numbers are given in turn: the next one up is the oldest.
        let after = (Bound::Excluded(self.last_id), Bound::Unbounded);
        let next_up = self.unacknowledged.range(after).next();
        let oldest = next_up.or_else(|| self.unacknowledged.first_key_value());
        self.waits = oldest.map(|(id, _)| *id);
        self.out.extend(PING);
        (self.is_asked, self.received) = (true, 0);
        self.ping_due_ns = after_ns(self.keep_alive);
        Ok(())
    }

    /// A number that no packet under way has.
    fn id(&mut self) -> u16 {
        loop {
            self.last_id = self.last_id.wrapping_add(1);
            if self.last_id != 0 && !self.unacknowledged.contains_key(&self.last_id) {
                return self.last_id;
            }
        }
    }
}

pub(super) fn after_ns(time: Duration) -> u64 {
    clock::monotonic_ns() + time.as_nanos() as u64
}

/// Finds the error of TLS in one of reading.
fn tls_or_io(error: io::Error) -> Lost {
    match error.downcast::<TlsError>() {
        Ok(error) => Lost::Tls { error },
        Err(error) => Lost::Io(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_alerts_about_certificates_ask_for_one_and_a_failure_of_the_broker_may_pass() {
        use AlertDescription as Alert;
        for (alert, remedy, is_permanent) in [
            (Alert::CertificateRequired, "`mqtt.tls.certificate`", true),
            (Alert::UnknownCA, "`mqtt.tls.certificate`", true),
            (Alert::ProtocolVersion, "TLS 1.2 or 1.3", true),
            (Alert::InternalError, "own log", false),
            (Alert::UnrecognisedName, "own log", true),
        ] {
            let error = TlsError::AlertReceived(alert);
            let lost = Lost::Tls { error };
            assert!(lost.to_string().contains(remedy), "{lost}");
            assert_eq!(lost.is_permanent(), is_permanent, "{lost}");
        }
    }
}
