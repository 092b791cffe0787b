//! The zenoh session: keys, connections and arriving messages. Only this file names zenoh.
//!
//! There is no discovery: a link connects to the addresses of its file and to no others. Payloads
//! never use zenoh's own shared memory.

use std::borrow::Cow;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;

use joulebus_bus::clock;
use serde_json::json;
use zenoh::Wait as _;
use zenoh::bytes::ZBytes;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::CongestionControl;
use zenoh::sample::{Sample, SampleKind};

use crate::config::{Mode, NetworkSettings};
use crate::protocol::carried::Kind;
use crate::wall_clock::WallClock;

/// Maximum number of queued messages for a thread. Beyond it new messages are dropped and counted.
const MAX_QUEUED: usize = 256;
/// Maximum size of the queue, in messages of maximum length.
const MAX_QUEUED_LONGEST: usize = 4;
/// Timeout of a silent peer, ms. It is shorter than the silence that a link reports, and longer
/// than usual interruptions of a network.
const PEER_TIMEOUT_MS: u64 = 1_000;
/// Timeout of a message that waits for room in the transmit queue before it is dropped, µs. A
/// message of many batches waits ten times as long.
const SEND_TIMEOUT_US: u64 = 50_000;
/// Timeout of a client's attempt to reach a router, ms.
const ROUTER_TIMEOUT_MS: i64 = 1_000;

/// An event of the network.
#[derive(Debug)]
pub(crate) enum Event {
    /// A message from the link `from`.
    Message { from: Arc<str>, bytes: Bytes, arrived_ns: u64 },
    /// The link of that name has left, or its connection is lost.
    Lost { name: Arc<str> },
}

/// The payload of a message.
#[derive(Debug)]
pub(crate) struct Bytes(ZBytes);

impl Bytes {
    /// The contiguous payload, copied only if it arrived in parts.
    pub(crate) fn get(&self) -> Cow<'_, [u8]> {
        self.0.to_bytes()
    }
}

/// The queue of arriving events for one thread, bounded in messages and bytes.
#[derive(Debug)]
pub(crate) struct Inbox {
    entry: Entry,
    receiver: Receiver<Event>,
    _subscriptions: Vec<Subscriber<()>>,
}

/// The producing end of an [`Inbox`], used by zenoh's threads.
#[derive(Debug, Clone)]
struct Entry {
    sender: SyncSender<Event>,
    counts: Arc<Counts>,
    max_bytes: usize,
}

#[derive(Debug, Default)]
struct Counts {
    /// Total size of the queued messages.
    waiting_bytes: AtomicUsize,
    /// Messages dropped because the queue was full.
    overflowed: AtomicU64,
}

impl Inbox {
    /// `max_message_bytes` is the maximum size of an expected message.
    pub(crate) fn new(max_message_bytes: usize) -> Self {
        let (sender, receiver) = sync_channel(MAX_QUEUED);
        let entry = Entry {
            sender,
            counts: Arc::default(),
            max_bytes: max_message_bytes.saturating_mul(MAX_QUEUED_LONGEST),
        };
        Self { entry, receiver, _subscriptions: Vec::new() }
    }

    /// Returns the next event, waiting at most `wait`.
    ///
    /// # Errors
    /// The time has passed, or the network has ended.
    pub(crate) fn next(&self, wait: Duration) -> Result<Event, RecvTimeoutError> {
        let event = self.receiver.recv_timeout(wait)?;
        let waiting = &self.entry.counts.waiting_bytes;
        waiting.fetch_sub(event.bytes(), Ordering::Relaxed);
        Ok(event)
    }

    /// Messages dropped because this host was too slow.
    pub(crate) fn overflowed(&self) -> u64 {
        self.entry.counts.overflowed.load(Ordering::Relaxed)
    }
}

impl Entry {
    /// Never blocks: the caller is a thread of zenoh.
    fn put(&self, event: Event) {
        let (bytes, counts) = (event.bytes(), &self.counts);
        let before = counts.waiting_bytes.fetch_add(bytes, Ordering::Relaxed);
        let has_room = before.saturating_add(bytes) <= self.max_bytes;
        if !has_room || self.sender.try_send(event).is_err() {
            counts.waiting_bytes.fetch_sub(bytes, Ordering::Relaxed);
            counts.overflowed.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl Event {
    fn bytes(&self) -> usize {
        match self {
            Self::Message { bytes, .. } => bytes.0.len(),
            Self::Lost { .. } => 0,
        }
    }
}

/// The connection to the other hosts of a fleet.
#[derive(Debug)]
pub(crate) struct Network {
    session: zenoh::Session,
    fleet: String,
    name: String,
    realtime_within_ns: Option<u64>,
    _token: LivelinessToken,
}

/// A publisher of one key.
#[derive(Debug)]
pub(crate) struct Outlet(Publisher<'static>);

impl Outlet {
    /// Sends a message. If zenoh has no room for it, it is dropped, and the receiver counts it as
    /// missing.
    pub(crate) fn send(&self, bytes: Vec<u8>) {
        if let Err(error) = self.0.put(bytes).wait() {
            tracing::debug!(%error, "a message was not sent");
        }
    }
}

impl Network {
    /// Opens the addresses and announces this link.
    ///
    /// `hosts` is set on a worker's host. It has the links whose samples are taken and the links of
    /// the other candidates, by the names in their certificates.
    ///
    /// # Errors
    /// [`NetworkError`].
    pub(crate) fn open(
        settings: &NetworkSettings,
        (fleet, name): (&str, &str),
        hosts: Option<(&[&str], &[&str])>,
        max_message_bytes: usize,
    ) -> Result<Self, NetworkError> {
        let mut config = configured(settings, max_message_bytes)?;
        if let Some(hosts) = hosts
            && settings.tls.is_some()
            && settings.mode == Mode::Peer
        {
            let value = access(fleet, name, hosts);
            insert(&mut config, "access_control", &value)?;
        }
        let session = zenoh::open(config).wait().map_err(|reason| NetworkError::Open {
            listen: settings.listen.clone(),
            connect: settings.connect.clone(),
            reason: reason.to_string(),
        })?;
        let key = format!("joulebus/{fleet}/links/{name}");
        let token = session.liveliness().declare_token(key).wait()?;
        Ok(Self {
            session,
            fleet: fleet.to_owned(),
            name: name.to_owned(),
            realtime_within_ns: settings.realtime_within_ns,
            _token: token,
        })
    }

    /// This host's realtime clock, as a stream reads it.
    pub(crate) fn wall_clock(&self) -> WallClock {
        WallClock::new(self.realtime_within_ns)
    }

    /// The publisher of frames for the link `to`.
    ///
    /// # Errors
    /// [`NetworkError`].
    pub(crate) fn frames_to(&self, kind: Kind, to: &str) -> Result<Outlet, NetworkError> {
        let Self { fleet, name, .. } = self;
        let key = format!("joulebus/{fleet}/{}/{name}/{to}", kind.name());
        self.outlet(key)
    }

    /// The publisher of requests to the link `from`.
    ///
    /// # Errors
    /// [`NetworkError`].
    pub(crate) fn requests_to(&self, kind: Kind, from: &str) -> Result<Outlet, NetworkError> {
        let Self { fleet, name, .. } = self;
        let key = format!("joulebus/{fleet}/ask/{}/{from}/{name}", kind.name());
        self.outlet(key)
    }

    /// Subscribes the inbox to frames from the link `from` to this one, and to the loss of that
    /// link.
    ///
    /// # Errors
    /// [`NetworkError`].
    pub(crate) fn take_frames(
        &self,
        kind: Kind,
        from: &str,
        inbox: &mut Inbox,
    ) -> Result<(), NetworkError> {
        let Self { fleet, name, .. } = self;
        let key = format!("joulebus/{fleet}/{}/{from}/{name}", kind.name());
        let named: Arc<str> = from.into();
        self.subscribe(key, inbox, move |_| Some(Arc::clone(&named)))?;
        self.watch(from, inbox)
    }

    /// Subscribes the inbox to the loss of the link `name`, or of all links with `*`.
    fn watch(&self, name: &str, inbox: &mut Inbox) -> Result<(), NetworkError> {
        let entry = inbox.entry.clone();
        let key = format!("joulebus/{}/links/{name}", self.fleet);
        let liveliness = self.session.liveliness();
        let subscription = liveliness
            .declare_subscriber(key)
            .callback(move |sample| {
                if let (SampleKind::Delete, Some(name)) = (sample.kind(), last_part(&sample)) {
                    entry.put(Event::Lost { name });
                }
            })
            .wait()?;
        inbox._subscriptions.push(subscription);
        Ok(())
    }

    /// Subscribes the inbox to requests for frames of this link.
    ///
    /// # Errors
    /// [`NetworkError`].
    pub(crate) fn take_requests(&self, kind: Kind, inbox: &mut Inbox) -> Result<(), NetworkError> {
        let Self { fleet, name, .. } = self;
        let key = format!("joulebus/{fleet}/ask/{}/{name}/*", kind.name());
        self.subscribe(key, inbox, last_part)?;
        self.watch("*", inbox)
    }

    fn subscribe(
        &self,
        key: String,
        inbox: &mut Inbox,
        from: impl Fn(&Sample) -> Option<Arc<str>> + Send + Sync + 'static,
    ) -> Result<(), NetworkError> {
        let entry = inbox.entry.clone();
        let subscriber = self.session.declare_subscriber(key);
        let subscription = subscriber
            .callback(move |sample| {
                let arrived_ns = clock::monotonic_ns();
                let Some(from) = from(&sample) else {
                    return;
                };
                let event =
                    Event::Message { from, bytes: Bytes(sample.payload().clone()), arrived_ns };
                entry.put(event);
            })
            .wait()?;
        inbox._subscriptions.push(subscription);
        Ok(())
    }

    fn outlet(&self, key: String) -> Result<Outlet, NetworkError> {
        let publisher = self
            .session
            .declare_publisher(key)
            .congestion_control(CongestionControl::Drop)
            .express(true)
            .wait()?;
        Ok(Outlet(publisher))
    }
}

/// The name of a link, the last part of its keys.
fn last_part(sample: &Sample) -> Option<Arc<str>> {
    let key = sample.key_expr().as_str();
    key.rsplit_once('/').map(|(_, name)| name.into())
}

/// The complete configuration of zenoh. Keys that are not set here keep their defaults. No file or
/// environment variable changes them.
fn configured(
    settings: &NetworkSettings,
    max_message_bytes: usize,
) -> Result<zenoh::Config, NetworkError> {
    let mut config = zenoh::Config::default();
    let mut set = |key: &str, value: serde_json::Value| insert(&mut config, key, &value);
    set("mode", json!(settings.mode.name()))?;
    set("connect/endpoints", json!(settings.connect))?;
    set("listen/endpoints", json!(settings.listen))?;
    // A client needs its router. A link that does not listen retries without end (-1), in the
    // background. A link that listens tries once (0), because peers that start later connect to it.
    // If both peers retried without end, each would go on after they are connected. Zenoh refuses
    // the second connection. If a peer is cut off at that moment, the other receives nothing for
    // ten seconds.
    let is_client = settings.mode == Mode::Client;
    let within_ms = match (is_client, settings.listen.is_empty()) {
        (true, _) => ROUTER_TIMEOUT_MS,
        (false, true) => -1,
        (false, false) => 0,
    };
    set("connect/timeout_ms", json!(within_ms))?;
    set("connect/exit_on_failure", json!(is_client))?;
    set(
        "connect/retry",
        json!({"period_init_ms": 200, "period_max_ms": 1_000, "period_increase_factor": 1.5}),
    )?;
    set("listen/exit_on_failure", json!(true))?;
    set("scouting/multicast/enabled", json!(false))?;
    // No gossip: announce no peers, and connect to none that others announce.
    let nobody = json!({"peer": [], "router": [], "client": []});
    set("scouting/gossip/target", nobody.clone())?;
    set("scouting/gossip/autoconnect", nobody)?;
    set("transport/link/tx/lease", json!(PEER_TIMEOUT_MS))?;
    set("transport/link/rx/max_message_size", json!(max_message_bytes))?;
    // Few frames of a link are in flight. They need room even while a thread of zenoh gets no
    // processor, and a long frame takes many batches.
    set("transport/link/tx/queue/size/data", json!(16))?;
    let drop = "transport/link/tx/queue/congestion_control/drop";
    set(&format!("{drop}/wait_before_drop"), json!(SEND_TIMEOUT_US))?;
    set(&format!("{drop}/max_wait_before_drop_fragments"), json!(10 * SEND_TIMEOUT_US))?;
    if let Some(tls) = &settings.tls {
        set("transport/link/tls/root_ca_certificate", json!(tls.ca))?;
        set("transport/link/tls/listen_certificate", json!(tls.certificate))?;
        set("transport/link/tls/connect_certificate", json!(tls.certificate))?;
        set("transport/link/tls/listen_private_key", json!(tls.key))?;
        set("transport/link/tls/connect_private_key", json!(tls.key))?;
        set("transport/link/tls/enable_mtls", json!(true))?;
        set("transport/link/tls/verify_name_on_connect", json!(true))?;
        set("transport/link/tls/close_link_on_expiration", json!(true))?;
    }
    Ok(config)
}

fn insert(
    config: &mut zenoh::Config,
    key: &str,
    value: &serde_json::Value,
) -> Result<(), NetworkError> {
    let reason = |reason: zenoh::Error| NetworkError::Config {
        key: key.to_owned(),
        reason: reason.to_string(),
    };
    config.insert_json5(key, &value.to_string()).map_err(reason)
}

/// Access rules of a worker's link.
///
/// Every link with a certificate of the fleet may request outputs. Samples are accepted from the
/// links that the file names. States and terms are accepted from the other candidates of the shard,
/// which this link requests them from. Each link is bound to the name in its certificate.
fn access(fleet: &str, name: &str, (takes, candidates): (&[&str], &[&str])) -> serde_json::Value {
    let key = |rest: &str| format!("joulebus/{fleet}/{rest}");
    let both = ["ingress", "egress"];
    let mut rules = vec![
        json!({"id": "links", "permission": "allow", "flows": both, "key_exprs": [key("links/*")],
            "messages": ["liveliness_token", "declare_liveliness_subscriber", "liveliness_query"]}),
        json!({"id": "ask", "permission": "allow", "flows": both, "messages": ["put", "declare_subscriber"],
            "key_exprs": [key(&format!("ask/outputs/{name}/*")), key("ask/samples/*/*")]}),
        json!({"id": "outputs", "permission": "allow", "flows": both, "messages": ["put", "declare_subscriber"],
            "key_exprs": [key(&format!("outputs/{name}/*"))]}),
        json!({"id": "take", "permission": "allow", "flows": ["egress"], "messages": ["declare_subscriber"],
            "key_exprs": [key(&format!("samples/*/{name}"))]}),
    ];
    let mut subjects = vec![json!({"id": "all"})];
    let mut policies =
        vec![json!({"subjects": ["all"], "rules": ["links", "ask", "outputs", "take"]})];
    if !candidates.is_empty() {
        let keys = |of: &dyn Fn(&str) -> String| -> Vec<String> {
            candidates.iter().map(|other| key(&of(other))).collect()
        };
        // Let this link declare its requests to the candidates that accept them.
        for (id, flow, message, keys) in [
            (
                "candidates",
                "ingress",
                "declare_subscriber",
                keys(&|other| format!("ask/outputs/{other}/*")),
            ),
            ("requests", "egress", "put", keys(&|other| format!("ask/outputs/{other}/{name}"))),
            (
                "states",
                "egress",
                "declare_subscriber",
                keys(&|other| format!("outputs/{other}/{name}")),
            ),
        ] {
            rules.push(
                json!({"id": id, "permission": "allow", "flows": [flow], "messages": [message], "key_exprs": keys}),
            );
        }
        policies.push(json!({"subjects": ["all"], "rules": ["candidates", "requests", "states"]}));
    }
    let of_samples = takes.iter().map(|from| ("samples", from));
    let of_states = candidates.iter().map(|from| ("outputs", from));
    for (kind, from) in of_samples.chain(of_states) {
        let id = format!("{kind} of {from}");
        rules.push(
            json!({"id": id, "permission": "allow", "flows": ["ingress"], "messages": ["put"],
            "key_exprs": [key(&format!("{kind}/{from}/{name}"))]}),
        );
        subjects.push(json!({"id": id, "cert_common_names": [from]}));
        policies.push(json!({"subjects": [id], "rules": [id]}));
    }
    json!({"enabled": true, "default_permission": "deny", "rules": rules, "subjects": subjects, "policies": policies})
}

/// Errors of the network.
#[derive(Debug, thiserror::Error)]
pub(crate) enum NetworkError {
    #[error(
        "cannot open the network (listen {listen:?}, connect {connect:?}): {reason}. Are the \
            addresses this host's, and \
         free?"
    )]
    Open { listen: Vec<String>, connect: Vec<String>, reason: String },
    #[error("zenoh refuses {key}: {reason}")]
    Config { key: String, reason: String },
    #[error("zenoh refuses a key: {0}")]
    Key(#[from] zenoh::Error),
}

#[cfg(test)]
mod tests {
    use serde_json::Value;

    use super::*;

    #[test]
    fn samples_states_and_terms_come_under_the_name_in_the_certificate_alone() {
        let access = access("lab", "base-1", (&["edge"], &["base-2", "base-3"]));
        let list = |value: &Value| -> Vec<String> {
            let texts = value.as_array().unwrap().iter();
            texts.map(|text| text.as_str().unwrap().to_owned()).collect()
        };
        let with = |part: &str, id: &str| -> Value {
            let all = access[part].as_array().unwrap();
            all.iter().find(|entry| entry["id"] == id).unwrap().clone()
        };
        let mut found = Vec::new();
        for policy in access["policies"].as_array().unwrap() {
            for rule in list(&policy["rules"]) {
                let rule = with("rules", &rule);
                let comes = list(&rule["flows"]).contains(&"ingress".to_owned());
                if !comes || !list(&rule["messages"]).contains(&"put".to_owned()) {
                    continue;
                }
                for subject in list(&policy["subjects"]) {
                    let names = &with("subjects", &subject)["cert_common_names"];
                    let who = names.as_array().map(|_| list(names).join(","));
                    for key in list(&rule["key_exprs"]) {
                        found.push((key, who.clone().unwrap_or_default()));
                    }
                }
            }
        }
        for (key, who) in [
            ("samples/edge/base-1", "edge"),
            ("outputs/base-2/base-1", "base-2"),
            ("outputs/base-3/base-1", "base-3"),
        ] {
            let key = format!("joulebus/lab/{key}");
            let of_key: Vec<_> = found.iter().filter(|(of, _)| *of == key).collect();
            assert_eq!(of_key, [&(key.clone(), who.to_owned())]);
        }
        // The rules for all certificates allow only requests, and this link's outputs to those that
        // requested them.
        let of_all = found.iter().filter(|(_, who)| who.is_empty());
        for (key, _) in of_all {
            let is_request = key.starts_with("joulebus/lab/ask/");
            assert!(is_request || key == "joulebus/lab/outputs/base-1/*", "{key}");
        }
    }
}
