//! The network: keys, zenoh's configuration and arriving messages. Only this file and `session.rs`
//! name zenoh.
//!
//! There is no discovery: a link connects to the addresses of its file and to no others. Payloads
//! never use zenoh's own shared memory.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;

use joulebus_bus::clock;
use serde_json::json;
use zenoh::Wait as _;
use zenoh::bytes::ZBytes;
use zenoh::pubsub::Publisher;
use zenoh::sample::{Sample, SampleKind};

use crate::config::{Mode, NetworkSettings, TlsSettings};
use crate::contact::{Contact, SILENCE_TIMEOUT_NS};
use crate::proof::{Prover, Verifier};
use crate::protocol::carried::Kind;
use crate::protocol::message::MAX_REQUEST_BYTES;
use crate::session::{Declared, Session};

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

/// The payload of a message, and the proof of its sender.
#[derive(Debug)]
pub(crate) struct Bytes(ZBytes, Option<ZBytes>);

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
    /// Set if the messages are requests and links have certificates.
    verifier: Option<Verifier>,
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
        Self { entry, receiver, verifier: None }
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

    /// True if the request comes from the link of that name. False if that is not known yet.
    pub(crate) fn verify(
        &mut self,
        from: &Arc<str>,
        bytes: &Bytes,
        arrived_ns: u64,
    ) -> anyhow::Result<bool> {
        let Some(verifier) = &mut self.verifier else {
            return Ok(true);
        };
        let proof = bytes.1.as_ref().map(ZBytes::to_bytes).unwrap_or_default();
        verifier.verify(from, &proof, arrived_ns)
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
            Self::Message { bytes, .. } => bytes.0.len() + bytes.1.as_ref().map_or(0, ZBytes::len),
            Self::Lost { .. } => 0,
        }
    }
}

/// The connection to the other hosts of a fleet.
#[derive(Debug)]
pub(crate) struct Network {
    session: Arc<Session>,
    fleet: String,
    name: String,
    tls: Option<TlsSettings>,
}

/// A publisher of one key.
#[derive(Debug)]
pub(crate) struct Outlet {
    session: Arc<Session>,
    key: String,
    /// The publisher, and the number of its session.
    publisher: Option<(u64, Publisher<'static>)>,
    /// Set for requests if links have certificates.
    prover: Option<Prover>,
    /// Set for requests: the stream that they ask for.
    contact: Option<Arc<Contact>>,
}

impl Outlet {
    /// Sends a message. If zenoh has no room for it, or the session is being opened, it is dropped,
    /// and the receiver counts it as missing.
    pub(crate) fn send(&mut self, bytes: Vec<u8>) {
        let now_ns = clock::monotonic_ns();
        if let Some(contact) = &self.contact {
            contact.asked(now_ns);
        }
        let number = self.session.number();
        if self.publisher.as_ref().is_none_or(|(of, _)| *of != number) {
            self.publisher = match self.session.publisher(&self.key) {
                Ok(publisher) => publisher,
                Err(error) => {
                    tracing::debug!(%error, "a publisher was not declared");
                    None
                }
            };
        }
        let Some((_, publisher)) = &self.publisher else {
            return;
        };
        let proof = self.prover.as_mut().map(|prover| prover.proof(now_ns));
        if let Err(error) = publisher.put(bytes).attachment(proof).wait() {
            tracing::debug!(%error, "a message was not sent");
        }
    }
}

impl Network {
    /// Opens the addresses and announces this link.
    pub(crate) fn open(
        settings: &NetworkSettings,
        (fleet, name): (&str, &str),
        peers: &Peers<'_>,
        max_message_bytes: usize,
    ) -> Result<Self, NetworkError> {
        let mut config = configured(settings, max_message_bytes)?;
        if settings.tls.is_some() && settings.mode == Mode::Peer {
            let value = access(fleet, name, peers);
            insert(&mut config, "access_control", &value)?;
        }
        let token = format!("joulebus/{fleet}/links/{name}");
        // Peers that are there already do not connect to a session that is opened anew. So it goes
        // on until it has reached them.
        let mut again = config.clone();
        if settings.mode == Mode::Peer {
            insert(&mut again, "connect/timeout_ms", &json!(-1))?;
        }
        let session = Session::open(config, again, token).map_err(|reason| NetworkError::Open {
            listen: settings.listen.clone(),
            connect: settings.connect.clone(),
            reason: reason.to_string(),
        })?;
        Ok(Self {
            session: Arc::new(session),
            fleet: fleet.to_owned(),
            name: name.to_owned(),
            tls: settings.tls.clone(),
        })
    }

    /// Opens another session if this one no longer carries a stream of a link that is present.
    ///
    /// Zenoh loses the subscriptions of a peer if both connect to each other, the connections break
    /// and only one of the two notices it (eclipse-zenoh/zenoh#2806). Nothing else ends that state.
    pub(crate) fn reopen_if_split(&self) {
        let now_ns = clock::monotonic_ns();
        if let Some(name) = self.session.is_split(now_ns) {
            tracing::warn!(
                "nothing has come from {name} for {} s, although its link is connected: this link connects anew",
                SILENCE_TIMEOUT_NS / 1_000_000_000
            );
            self.session.close(now_ns);
        }
        self.session.open_if_closed(now_ns);
    }

    /// The publisher of frames for the link `to`.
    pub(crate) fn frames_to(&self, kind: Kind, to: &str) -> Result<Outlet, NetworkError> {
        let Self { fleet, name, .. } = self;
        let key = format!("joulebus/{fleet}/{}/{name}/{to}", kind.name());
        self.outlet(key, None, None)
    }

    /// The publisher of requests to the link `from`.
    pub(crate) fn requests_to(&self, kind: Kind, from: &str) -> Result<Outlet, NetworkError> {
        let Self { fleet, name, .. } = self;
        let key = format!("joulebus/{fleet}/ask/{}/{from}/{name}", kind.name());
        let prover = self.tls.as_ref().map(|tls| Prover::new(tls, &key));
        let contact = self.session.contact(kind, from);
        self.outlet(key, prover, Some(contact))
    }

    /// Subscribes the inbox to frames from the link `from` to this one, and to the loss of that
    /// link.
    pub(crate) fn take_frames(
        &self,
        kind: Kind,
        from: &str,
        inbox: &mut Inbox,
    ) -> Result<(), NetworkError> {
        let Self { fleet, name, .. } = self;
        let key = format!("joulebus/{fleet}/{}/{from}/{name}", kind.name());
        let named: Arc<str> = from.into();
        let contact = self.session.contact(kind, from);
        let heard = Arc::clone(&contact);
        self.subscribe(key, inbox, move |_| {
            heard.heard(clock::monotonic_ns());
            Some(Arc::clone(&named))
        })?;
        self.watch(from, inbox, Some(contact))
    }

    /// Subscribes the inbox to the loss of the link `name`, or of all links with `*`, and notes in
    /// `contact` whether it is present.
    fn watch(
        &self,
        name: &str,
        inbox: &Inbox,
        contact: Option<Arc<Contact>>,
    ) -> Result<(), NetworkError> {
        let entry = inbox.entry.clone();
        let deliver = move |sample: &Sample| {
            let is_present = sample.kind() != SampleKind::Delete;
            if let Some(contact) = &contact {
                contact.present(is_present, clock::monotonic_ns());
            }
            if let Some(name) = last_part(sample).filter(|_| !is_present) {
                entry.put(Event::Lost { name });
            }
        };
        let key = format!("joulebus/{}/links/{name}", self.fleet);
        Ok(self.session.declare(Declared::Presence(key), Arc::new(deliver))?)
    }

    /// Subscribes the inbox to requests for frames of this link.
    pub(crate) fn take_requests(&self, kind: Kind, inbox: &mut Inbox) -> Result<(), NetworkError> {
        let Self { fleet, name, .. } = self;
        let prefix = format!("joulebus/{fleet}/ask/{}/{name}/", kind.name());
        self.subscribe(format!("{prefix}*"), inbox, last_part)?;
        if let Some(tls) = &self.tls {
            let verifier = Verifier::new(&tls.ca, prefix);
            inbox.verifier = Some(verifier.map_err(|error| NetworkError::Authority {
                path: tls.ca.clone(),
                reason: format!("{error:#}"),
            })?);
        }
        self.watch("*", inbox, None)
    }

    fn subscribe(
        &self,
        key: String,
        inbox: &Inbox,
        from: impl Fn(&Sample) -> Option<Arc<str>> + Send + Sync + 'static,
    ) -> Result<(), NetworkError> {
        let entry = inbox.entry.clone();
        let deliver = move |sample: &Sample| {
            let arrived_ns = clock::monotonic_ns();
            let Some(from) = from(sample) else {
                return;
            };
            let bytes = Bytes(sample.payload().clone(), sample.attachment().cloned());
            entry.put(Event::Message { from, bytes, arrived_ns });
        };
        Ok(self.session.declare(Declared::Messages(key), Arc::new(deliver))?)
    }

    fn outlet(
        &self,
        key: String,
        prover: Option<Prover>,
        contact: Option<Arc<Contact>>,
    ) -> Result<Outlet, NetworkError> {
        let publisher = self.session.publisher(&key)?;
        Ok(Outlet { session: Arc::clone(&self.session), key, publisher, prover, contact })
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
    // If both peers retried without end, they would have two connections. If these break and one of
    // the peers does not notice it, zenoh loses its subscriptions (`reopen_if_split`).
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
    set("transport/link/rx/max_message_size", json!(max_message_bytes.max(MAX_REQUEST_BYTES)))?;
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

/// Whose messages a link accepts, by the names in their certificates.
#[derive(Debug, Default)]
pub(crate) struct Peers<'a> {
    /// This host has a worker.
    pub(crate) is_worker: bool,
    /// Links whose samples are taken.
    pub(crate) samples_from: Vec<&'a str>,
    /// Links that get the samples published here.
    pub(crate) samples_to: Vec<&'a str>,
    /// Links whose outputs are requested: the workers that this host follows, or the other
    /// candidates.
    pub(crate) outputs_from: Vec<&'a str>,
}

/// Access rules of a link.
///
/// Every link with a certificate of the fleet may request outputs of a worker, each under its own
/// name ([`crate::proof`]). Everything else is bound to the names that the file has: samples, the
/// outputs that this link requests, and requests for samples.
fn access(fleet: &str, name: &str, peers: &Peers<'_>) -> serde_json::Value {
    const SUBSCRIBE: &str = "declare_subscriber";
    let key = |rest: String| format!("joulebus/{fleet}/{rest}");
    let mut rules = vec![json!({"id": "links", "permission": "allow",
        "flows": ["ingress", "egress"], "key_exprs": [key("links/*".to_owned())],
        "messages": ["liveliness_token", "declare_liveliness_subscriber", "liveliness_query"]})];
    let mut subjects = vec![json!({"id": "all"})];
    let mut policies = vec![json!({"subjects": ["all"], "rules": ["links"]})];
    let mut ids = BTreeSet::new();
    let mut allow = |flow: &str, message: &str, subject: Option<&str>, rest: String| {
        let id = format!("{flow} {message} {rest}");
        if !ids.insert(id.clone()) {
            return;
        }
        rules.push(json!({"id": id, "permission": "allow", "flows": [flow],
            "messages": [message], "key_exprs": [key(rest)]}));
        let of = match subject {
            Some(name) => {
                subjects.push(json!({"id": id, "cert_common_names": [name]}));
                id.clone()
            }
            None => "all".to_owned(),
        };
        policies.push(json!({"subjects": [of], "rules": [id]}));
    };
    // Who gets frames of a kind declares them, and this link declares the requests.
    let mut gives = |kind: &str, to: &str, subject: Option<&str>| {
        allow("egress", SUBSCRIBE, None, format!("ask/{kind}/{name}/*"));
        allow("ingress", "put", subject, format!("ask/{kind}/{name}/{to}"));
        allow("ingress", SUBSCRIBE, subject, format!("{kind}/{name}/{to}"));
        allow("egress", "put", subject, format!("{kind}/{name}/{to}"));
    };
    if peers.is_worker {
        gives("outputs", "*", None);
    }
    peers.samples_to.iter().for_each(|to| gives("samples", to, Some(to)));
    let samples = peers.samples_from.iter().map(|from| ("samples", from));
    let outputs = peers.outputs_from.iter().map(|from| ("outputs", from));
    for (kind, from) in samples.chain(outputs) {
        allow("ingress", SUBSCRIBE, None, format!("ask/{kind}/{from}/*"));
        allow("egress", "put", Some(from), format!("ask/{kind}/{from}/{name}"));
        allow("egress", SUBSCRIBE, Some(from), format!("{kind}/{from}/{name}"));
        allow("ingress", "put", Some(from), format!("{kind}/{from}/{name}"));
    }
    json!({"enabled": true, "default_permission": "deny", "rules": rules, "subjects": subjects,
        "policies": policies})
}

/// Errors of the network.
#[derive(Debug, thiserror::Error)]
pub(crate) enum NetworkError {
    #[error(
        "cannot open the network (listen {listen:?}, connect {connect:?}): {reason}. Are the \
         addresses this host's, and free?"
    )]
    Open { listen: Vec<String>, connect: Vec<String>, reason: String },
    #[error("zenoh refuses {key}: {reason}")]
    Config { key: String, reason: String },
    #[error("the authority's certificate in {path:?} cannot be used: {reason}")]
    Authority { path: PathBuf, reason: String },
    #[error("zenoh refuses a key: {0}")]
    Key(#[from] zenoh::Error),
}

#[cfg(test)]
mod tests {
    use serde_json::Value;

    use super::*;

    /// What may come in, and from which certificates.
    fn incoming(peers: &Peers<'_>) -> Vec<(String, String)> {
        let access = access("lab", "own", peers);
        let list = |value: &Value| -> Vec<String> {
            let texts = value.as_array().unwrap().iter();
            texts.map(|text| text.as_str().unwrap().to_owned()).collect()
        };
        let with = |part: &str, id: &str| -> Value {
            let all = access[part].as_array().unwrap();
            let mut found = all.iter().filter(|entry| entry["id"] == id);
            let first = found.next().unwrap().clone();
            assert!(found.next().is_none(), "{id} twice");
            first
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
                        let key = key.strip_prefix("joulebus/lab/").unwrap().to_owned();
                        found.push((key, who.clone().unwrap_or_default()));
                    }
                }
            }
        }
        found.sort();
        found
    }

    #[test]
    fn everything_but_requests_for_outputs_comes_under_the_name_in_the_certificate_alone() {
        let expected = |all: &[(&str, &str)]| -> Vec<(String, String)> {
            all.iter().map(|(key, who)| ((*key).to_owned(), (*who).to_owned())).collect()
        };
        let (samples_from, outputs_from) = (vec!["edge"], vec!["base-2", "base-3"]);
        let worker = Peers { is_worker: true, samples_from, outputs_from, ..Peers::default() };
        assert_eq!(
            incoming(&worker),
            expected(&[
                ("ask/outputs/own/*", ""),
                ("outputs/base-2/own", "base-2"),
                ("outputs/base-3/own", "base-3"),
                ("samples/edge/own", "edge"),
            ])
        );
        let (samples_to, outputs_from) = (vec!["base-1", "base-2"], vec!["base-1", "base-2"]);
        let other = Peers { samples_to, outputs_from, ..Peers::default() };
        assert_eq!(
            incoming(&other),
            expected(&[
                ("ask/samples/own/base-1", "base-1"),
                ("ask/samples/own/base-2", "base-2"),
                ("outputs/base-1/own", "base-1"),
                ("outputs/base-2/own", "base-2"),
            ])
        );
    }
}
