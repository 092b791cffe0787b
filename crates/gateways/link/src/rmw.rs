//! `joulebus link rmw-zenoh`: carries the messages of `joulebus bridge` over zenoh, as ROS 2's
//! `rmw_zenoh_cpp` does.
//!
//! The bridge starts this program, so that it need not have zenoh itself. It writes a line of JSON
//! to stdin ([`Asked`]) and then frames: the index of a written topic and the length of the
//! message, u32 in little endian each, and the message in CDR. Frames of read topics come back on
//! stdout. The indices of services follow those of topics. Their messages begin with the number of
//! the request, u64 in little endian, in both directions. Frames with the index [`NOTICE`] name a
//! publisher's topic and type in two lines. An empty one reports that the session is open. The end
//! of stdin ends the program.

use std::collections::{BTreeMap, HashSet};
use std::io::{self, BufRead as _, ErrorKind, Read as _, Write as _};
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use anyhow::{Context as _, anyhow};
use joulebus_bus::clock;
use joulebus_program::exit::Outcome;
use serde::Deserialize;
use zenoh::bytes::ZBytes;
use zenoh::key_expr::KeyExpr;
use zenoh::query::Query;
use zenoh::sample::{Sample, SampleKind};
use zenoh::time::Timestamp;
use zenoh::{Config, Session, Wait as _};

use crate::protocol;
use crate::protocol::rmw::{
    ATTACHMENT_BYTES, Endpoint, History, Node, Topic, announced, attachment,
};

/// Index of frames that are no message.
const NOTICE: u32 = u32::MAX;
/// Maximum size of a message that is passed on, bytes. A longer one is cut to one byte more, so
/// that the bridge refuses it.
const MAX_BYTES: usize = 65_536;
/// Maximum size of the line that names all topics, bytes.
const MAX_ASKED_BYTES: u64 = 8 << 20;
/// Maximum number of remembered publishers. Each is announced once.
const MAX_ANNOUNCED: usize = 100_000;
/// Maximum number of requests that wait. The oldest one of the client with most then ends without a
/// response.
const MAX_WAITING: usize = 1_024;
/// The upper bits of a request's number name its client, for the bridge's turns.
const CLIENT_SHIFT: u32 = 48;
/// Without another session for so long a warning names the router.
const ALONE: Duration = Duration::from_secs(5);
/// The variables by which `rmw_zenoh_cpp` is configured: a file, and keys in place of the file's.
const FILE_VARIABLE: &str = "ZENOH_SESSION_CONFIG_URI";
const KEYS_VARIABLE: &str = "ZENOH_CONFIG_OVERRIDE";
/// Settings in which a session of `rmw_zenoh_cpp` differs from zenoh's own.
const SETTINGS: [(&str, &str); 8] = [
    ("mode", r#""peer""#),
    ("connect/endpoints", r#"["tcp/localhost:7447"]"#),
    ("connect/timeout_ms", "-1"),
    ("connect/exit_on_failure", "false"),
    ("listen/endpoints", r#"["tcp/localhost:0"]"#),
    ("scouting/multicast/enabled", "false"),
    ("scouting/gossip/enabled", "true"),
    ("timestamping/enabled", "true"),
];

/// Request of the bridge.
#[derive(Debug, Deserialize)]
struct Asked {
    node: Node,
    read: Vec<Topic>,
    write: Vec<Topic>,
    serve: Vec<Topic>,
}

/// A message of a latched topic.
#[derive(Debug, Clone)]
struct Sent {
    key: KeyExpr<'static>,
    stamp: Timestamp,
    attached: [u8; ATTACHMENT_BYTES],
    message: ZBytes,
}

/// Requests that wait for their response, by number.
#[derive(Debug)]
struct Requests<T = Query> {
    waiting: BTreeMap<u64, T>,
    /// Count of all requests.
    newest: u64,
}

impl<T> Default for Requests<T> {
    fn default() -> Self {
        Self { waiting: BTreeMap::new(), newest: 0 }
    }
}

impl<T> Requests<T> {
    /// Adds a request, and returns its number.
    fn add(&mut self, client: u16, request: T) -> u64 {
        self.newest += 1;
        let number = u64::from(client) << CLIENT_SHIFT | self.newest;
        self.waiting.insert(number, request);
        if self.waiting.len() > MAX_WAITING {
            let mut of_clients = BTreeMap::new();
            for waits in self.waiting.keys() {
                of_clients.entry(waits >> CLIENT_SHIFT).or_insert((0, *waits)).0 += 1;
            }
            let most = of_clients.values().max_by_key(|(count, _)| *count);
            most.and_then(|(_, oldest)| self.waiting.remove(oldest));
        }
        number
    }
}

pub(crate) fn run() -> anyhow::Result<Outcome> {
    let mut input = io::stdin().lock();
    let mut line = String::new();
    input.by_ref().take(MAX_ASKED_BYTES).read_line(&mut line)?;
    let Asked { mut node, read, write, serve } =
        serde_json::from_str(&line).context("`joulebus bridge` starts this program")?;
    let session = zenoh::open(config()?).wait().map_err(|error| anyhow!(error))?;
    node.session = session.zid().to_string();
    warn_if_alone(&session);
    let domain_id = node.domain_id;
    let declare = |token: String| {
        session.liveliness().declare_token(token).wait().map_err(|error| anyhow!(error))
    };
    let mut tokens = vec![declare(node.token())?];
    let mut caches_seen = Vec::new();
    let mut seen = HashSet::new();
    let publishers = session.liveliness().declare_subscriber(node.publishers());
    let publishers =
        publishers.history(true).callback_mut(move |token| announce(&token, &mut seen));
    let _publishers = publishers.wait().map_err(|error| anyhow!(error))?;
    let mut subscribers = Vec::new();
    for (number, topic) in (0_u32..).zip(&read) {
        let of = topic.clone();
        let subscriber = session.declare_subscriber(topic.keys(domain_id));
        let subscriber = subscriber.callback(move |sample| {
            if of.is_type_of(sample.key_expr().as_str()) {
                let message = sample.payload().to_bytes();
                pass_on(number, &message[..message.len().min(MAX_BYTES + 1)]);
            }
        });
        subscribers.push(subscriber.wait().map_err(|error| anyhow!(error))?);
        tokens.push(declare(node.endpoint(tokens.len(), Endpoint::Subscription, topic))?);
    }
    let mut publishers = Vec::new();
    let mut caches = Vec::new();
    for topic in &write {
        let publisher = session.declare_publisher(topic.key(domain_id));
        let publisher = publisher.wait().map_err(|error| anyhow!(error))?;
        let token = node.endpoint(tokens.len(), Endpoint::Publisher, topic);
        let id = xxhash_rust::xxh3::xxh3_128(token.as_bytes());
        let history = Arc::new(Mutex::new(History::new(topic.kept)));
        if topic.kept > 0 {
            let (key, kept) = (topic.history_key(domain_id, &node.session), Arc::clone(&history));
            let cache = session.declare_queryable(key.as_str());
            let cache = cache.callback(move |query| retell(&kept, &query));
            caches.push(cache.wait().map_err(|error| anyhow!(error))?);
            // Subscribers that were there first ask when they see it.
            caches_seen.push(declare(key)?);
        }
        publishers.push((publisher, id, 0_i64, history));
        tokens.push(declare(token)?);
    }
    let requests = Arc::<Mutex<Requests>>::default();
    let mut services = Vec::new();
    for (index, topic) in (read.len() as u32..).zip(&serve) {
        let requests = Arc::clone(&requests);
        // Clients ask complete services alone. Their key has the hash of their definition.
        let service = session.declare_queryable(topic.keys(domain_id)).complete(true);
        let service = service.callback(move |query| take(&requests, index, query));
        services.push(service.wait().map_err(|error| anyhow!(error))?);
        tokens.push(declare(node.endpoint(tokens.len(), Endpoint::Service, topic))?);
    }
    pass_on(NOTICE, b"");
    let mut message = Vec::new();
    while let Some(index) = next(&mut input, &mut message)? {
        if index as usize >= publishers.len() {
            respond(&requests, &message)?;
            continue;
        }
        let named = publishers.get_mut(index as usize).context("a topic that was not named")?;
        let (publisher, id, number, history) = named;
        *number += 1;
        let sent = Sent {
            key: publisher.key_expr().clone(),
            // By it subscribers know what they have already.
            stamp: session.new_timestamp(),
            attached: attachment(*number, clock::unix_ns() as i64, *id),
            message: message.as_slice().into(),
        };
        lock(history).add(sent.clone());
        // What nobody can take is dropped: the next message replaces it.
        let put = publisher.put(sent.message).attachment(sent.attached.as_slice());
        put.timestamp(sent.stamp).wait().map_err(|error| anyhow!(error))?;
    }
    Ok(Outcome::Done)
}

/// Answers a late subscriber with the newest messages.
fn retell(history: &Mutex<History<Sent>>, query: &Query) {
    let kept = lock(history).asked(query.parameters().get("_max"));
    for Sent { key, stamp, attached, message } in kept {
        let reply = query.reply(key, message).timestamp(stamp).attachment(attached.as_slice());
        // A subscriber may have gone.
        let _ = reply.wait().inspect_err(|error| tracing::debug!(%error, "history is not sent"));
    }
}

/// Ignores poisoning: no panic leaves the guarded data inconsistent.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Passes a request on with a number of its own.
fn take(requests: &Mutex<Requests>, index: u32, query: Query) {
    let request = query.payload().map(|payload| payload.to_bytes()).unwrap_or_default();
    let request = request[..request.len().min(MAX_BYTES + 1)].to_vec();
    let attached = query.attachment().map(|attached| attached.to_bytes()).unwrap_or_default();
    let client = xxhash_rust::xxh3::xxh3_64(protocol::rmw::sender(&attached)) as u16;
    let mut requests = lock(requests);
    let number = requests.add(client, query);
    pass_on(index, &[&number.to_le_bytes(), &request[..]].concat());
}

/// Sends the response to a request that still waits.
fn respond(requests: &Mutex<Requests>, message: &[u8]) -> anyhow::Result<()> {
    let (number, response) = message.split_first_chunk().context("a response without a number")?;
    let mut requests = lock(requests);
    let query = requests.waiting.remove(&u64::from_le_bytes(*number));
    drop(requests);
    let Some(query) = query else { return Ok(()) };
    let request = query.attachment().map(|attached| attached.to_bytes()).unwrap_or_default();
    let Some(attached) = protocol::rmw::response(&request, clock::unix_ns() as i64) else {
        tracing::warn!(key = %query.key_expr(), "a request without the attachment of rmw_zenoh");
        return Ok(());
    };
    let reply = query.reply(query.key_expr(), response).attachment(attached.as_slice());
    // A client may have gone.
    let _ = reply.wait().inspect_err(|error| tracing::debug!(%error, "a response is not sent"));
    Ok(())
}

/// The configuration as for any node of ROS 2.
fn config() -> anyhow::Result<Config> {
    let variable = |name| std::env::var(name).ok().filter(|text| !text.is_empty());
    let mut config = match variable(FILE_VARIABLE) {
        Some(file) => Config::from_file(Path::new(&file))
            .map_err(|error| anyhow!("{FILE_VARIABLE}={file:?}: {error}"))?,
        None => Config::default(),
    };
    let own = SETTINGS.iter().filter(|_| variable(FILE_VARIABLE).is_none());
    let own = own.map(|(key, value)| ((*key).to_owned(), (*value).to_owned()));
    let keys = variable(KEYS_VARIABLE).unwrap_or_default();
    let given = keys.split(';').filter_map(|entry| entry.split_once('='));
    for (key, value) in own.chain(given.map(|(key, value)| (key.to_owned(), value.to_owned()))) {
        let set = config.insert_json5(key.trim(), value.trim());
        set.map_err(|error| anyhow!("{KEYS_VARIABLE}, {key}={value}: {error}"))?;
    }
    Ok(config)
}

fn warn_if_alone(session: &Session) {
    let session = session.clone();
    std::thread::spawn(move || {
        std::thread::sleep(ALONE);
        let info = session.info();
        let is_alone =
            info.routers_zid().wait().next().is_none() && info.peers_zid().wait().next().is_none();
        if is_alone && !session.is_closed() {
            tracing::warn!(
                "no zenoh router and no other node is reached: `ros2 run rmw_zenoh_cpp rmw_zenohd` starts a router, \
                 {FILE_VARIABLE} and {KEYS_VARIABLE} say where it is (localhost:7447 without them)"
            );
        }
    });
}

fn announce(token: &Sample, seen: &mut HashSet<String>) {
    let key = token.key_expr().as_str();
    if token.kind() == SampleKind::Delete {
        seen.remove(key);
    } else if let Some(Topic { topic, kind, .. }) = announced(key)
        && seen.len() < MAX_ANNOUNCED
        && seen.insert(key.to_owned())
    {
        pass_on(NOTICE, format!("{topic}\n{kind}").as_bytes());
    }
}

/// Writes a frame to the bridge. A failure is ignored: the bridge has ended, and stdin ends too.
fn pass_on(index: u32, message: &[u8]) {
    static OUTPUT: Mutex<()> = Mutex::new(());
    let _whole = lock(&OUTPUT);
    let mut frame = Vec::with_capacity(8 + message.len());
    frame.extend_from_slice(&index.to_le_bytes());
    frame.extend_from_slice(&(message.len() as u32).to_le_bytes());
    frame.extend_from_slice(message);
    let mut output = io::stdout().lock();
    let _ = output.write_all(&frame).and_then(|()| output.flush());
}

/// The next message of the bridge. `None` at the end.
fn next(input: &mut impl io::Read, message: &mut Vec<u8>) -> anyhow::Result<Option<u32>> {
    let mut head = [[0; 4]; 2];
    match input.read_exact(head.as_flattened_mut()) {
        Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(None),
        read => read?,
    }
    let [index, length] = head.map(u32::from_le_bytes);
    message.resize(length as usize, 0);
    input.read_exact(message)?;
    Ok(Some(index))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_request_of_the_client_with_most_gives_way() {
        let mut requests = Requests::default();
        let other = requests.add(1, ());
        let many: Vec<u64> = (0..2 * MAX_WAITING).map(|_| requests.add(7, ())).collect();
        assert!(requests.waiting.contains_key(&other));
        let kept = many.iter().filter(|number| requests.waiting.contains_key(number));
        assert_eq!(kept.count(), MAX_WAITING - 1);
        assert!(requests.waiting.contains_key(many.last().unwrap()));
        assert_eq!(many[0] >> CLIENT_SHIFT, 7, "the bridge names the client by it");
    }
}
