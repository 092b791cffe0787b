//! A client of etcd's HTTP and JSON gateway (`/v3/…`, etcd 3.4 and later), for
//! [`crate::protocol::lease`].
//!
//! The gateway omits fields that are false, 0 or empty, and writes 64-bit integers as strings.

use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context as _, anyhow, bail};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD as BASE64;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use ureq::Agent;
use ureq::tls::{Certificate, ClientCert, PemItem, PrivateKey, RootCerts, TlsConfig, parse_pem};

use crate::config::LeaseSettings;
use crate::protocol::lease::{Call, Holder, MAX_TTL_S, Reply, StoreView};

/// A call may take this share of the lease's time to live, divided among all members.
const CALL_DIVISOR: u32 = 3;
/// Minimum time for a member to answer.
const MIN_CALL_TIMEOUT: Duration = Duration::from_millis(100);
/// Minimum time between two logged failures.
const LOG_INTERVAL: Duration = Duration::from_secs(10);
/// Maximum size of an answer, bytes.
const MAX_BYTES: u64 = 64 << 10;
const MAX_CERTIFICATE_BYTES: u64 = 1 << 20;
const NANOSECONDS: u64 = 1_000_000_000;

/// The etcd client of one candidate.
pub(crate) struct Etcd {
    agent: Agent,
    endpoints: Vec<String>,
    /// Index of the member that answered last.
    at: usize,
    ttl_s: u32,
    limit: Duration,
    /// Base64 names of the two keys.
    holder: String,
    term: String,
    own: String,
    user: Option<(String, String)>,
    token: Option<String>,
    /// The failure that was logged last, and when.
    last_failure: Option<(String, Instant)>,
}

/// The store knows no such lease (any longer).
#[derive(Debug, thiserror::Error)]
#[error("the lease is gone")]
struct LeaseGone;

/// The value of the holder's key.
#[derive(Debug, Serialize, Deserialize)]
struct HolderValue {
    name: String,
    term: u64,
}

/// A number that JSON has as a string, as a number, or not at all.
#[derive(Debug, Clone, Copy, Default)]
struct Number(u64);

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: serde::Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Form {
            Text(String),
            Number(u64),
        }
        let number = match Form::deserialize(from)? {
            Form::Number(number) => Some(number),
            Form::Text(text) => text.parse().ok(),
        };
        number.map(Self).ok_or_else(|| serde::de::Error::custom("not a number of 64 bits"))
    }
}

#[derive(Debug, Deserialize)]
struct Granted {
    #[serde(rename = "ID")]
    id: Number,
    #[serde(rename = "TTL")]
    ttl_s: Number,
}

#[derive(Debug, Deserialize)]
struct Renewed {
    result: RenewedResult,
}

#[derive(Debug, Deserialize)]
struct RenewedResult {
    /// Absent if the lease is gone.
    #[serde(rename = "TTL", default)]
    ttl_s: Number,
}

#[derive(Debug, Deserialize)]
struct Done {
    #[serde(default)]
    succeeded: bool,
    #[serde(default)]
    responses: Vec<Response>,
}

#[derive(Debug, Deserialize)]
struct Response {
    #[serde(alias = "responseRange")]
    response_range: Option<Range>,
}

#[derive(Debug, Default, Deserialize)]
struct Range {
    #[serde(default)]
    kvs: Vec<KeyValue>,
}

#[derive(Debug, Deserialize)]
struct KeyValue {
    #[serde(alias = "modRevision", default)]
    mod_revision: Number,
    #[serde(default)]
    value: String,
    #[serde(default)]
    lease: Number,
}

impl KeyValue {
    fn text(&self) -> anyhow::Result<String> {
        let bytes = BASE64.decode(&self.value)?;
        Ok(String::from_utf8(bytes)?)
    }
}

impl Etcd {
    /// Prepares a client. `own` is the name of this candidate.
    pub(crate) fn new(
        settings: &LeaseSettings,
        (fleet, own): (&str, &str),
    ) -> anyhow::Result<Self> {
        let key = |name: &str| BASE64.encode(format!("{}{fleet}/{name}", settings.prefix));
        let user = settings.user.as_ref().map(|(user, path)| {
            Ok::<_, std::io::Error>((user.clone(), joulebus_files::read_secret_line(path)?))
        });
        let members = settings.endpoints.len().try_into().unwrap_or(u32::MAX);
        let ttl = Duration::from_secs(settings.ttl_s.into());
        Ok(Self {
            agent: agent(settings)?,
            endpoints: settings.endpoints.clone(),
            at: 0,
            ttl_s: settings.ttl_s,
            limit: (ttl / CALL_DIVISOR / members).max(MIN_CALL_TIMEOUT),
            holder: key("holder"),
            term: key("term"),
            own: own.to_owned(),
            user: user.transpose().context("the password of etcd's user")?,
            token: None,
            last_failure: None,
        })
    }

    /// Calls the store.
    ///
    /// Logs the first failure, then at most one different failure per interval, until a call
    /// succeeds: members may fail for different reasons in alternation.
    pub(crate) fn call(&mut self, call: &Call) -> Reply {
        match self.try_call(call) {
            Ok(reply) => {
                if self.last_failure.take().is_some() {
                    tracing::info!("etcd answers again");
                }
                reply
            }
            Err(error) if error.is::<LeaseGone>() => Reply::Gone,
            Err(error) => {
                self.log_failure(format!("{error:#}"));
                Reply::Failed
            }
        }
    }

    fn log_failure(&mut self, error: String) {
        let is_logged = self.last_failure.as_ref().is_some_and(|(last_failure, at)| {
            *last_failure == error || at.elapsed() < LOG_INTERVAL
        });
        if !is_logged {
            tracing::warn!("etcd does not answer as it should: {error}");
            self.last_failure = Some((error, Instant::now()));
        }
    }

    fn try_call(&mut self, call: &Call) -> anyhow::Result<Reply> {
        match call {
            Call::Grant => {
                let body = json!({"TTL": self.ttl_s.to_string()});
                let granted: Granted = self.post("lease/grant", &body)?;
                anyhow::ensure!(granted.id.0 > 0, "it grants lease 0, which is none");
                Ok(Reply::Granted { lease: granted.id.0, ttl_ns: self.ttl_ns(granted.ttl_s)? })
            }
            Call::Renew { lease } => {
                let body = json!({"ID": lease.to_string()});
                let renewed: Renewed = self.post("lease/keepalive", &body)?;
                let ttl_ns = self.ttl_ns(renewed.result.ttl_s)?;
                Ok(Reply::Renewed { ttl_ns })
            }
            Call::Release { lease } => {
                let body = json!({"ID": lease.to_string()});
                self.post::<Value>("lease/revoke", &body).map(|_| Reply::Gone)
            }
            Call::Look => self.look().map(Reply::StoreView),
            Call::Acquire { lease, term, term_revision } => {
                let body = self.acquisition(*lease, *term, *term_revision)?;
                let done: Done = self.post("kv/txn", &body)?;
                Ok(Reply::Acquired(done.succeeded))
            }
        }
    }

    /// A time to live that the store states, ns. It may be longer than what was asked for, since
    /// etcd has a least one, and not longer than any that can be.
    fn ttl_ns(&self, stated: Number) -> anyhow::Result<u64> {
        let (asked_s, found_s) = (self.ttl_s, stated.0);
        anyhow::ensure!(
            found_s <= MAX_TTL_S.into(),
            "it states {found_s} s for a lease of {asked_s} s: allowed are up to {MAX_TTL_S} s"
        );
        Ok(found_s * NANOSECONDS)
    }

    /// Reads both keys in one transaction, so from a quorum and at one revision.
    fn look(&mut self) -> anyhow::Result<StoreView> {
        let range = |key: &str| json!({"requestRange": {"key": key}});
        let all = [&self.holder, &self.term].map(|key| range(key));
        let done: Done = self.post("kv/txn", &json!({"success": all}))?;
        let mut ranges = done.responses.into_iter().map(|response| response.response_range);
        let mut key = || -> anyhow::Result<Option<KeyValue>> {
            let range = ranges.next().flatten();
            let range = range.ok_or_else(|| anyhow!("an answer is missing"))?;
            Ok(range.kvs.into_iter().next())
        };
        let (holder, term) = (key()?, key()?);
        let holder = holder.map(|entry| {
            let value: HolderValue =
                serde_json::from_str(&entry.text()?).context("the holder's key")?;
            Ok::<_, anyhow::Error>(Holder {
                name: value.name,
                term: value.term,
                lease: entry.lease.0,
            })
        });
        let number = |entry: &KeyValue| {
            let term: u64 = entry.text()?.parse().context("the term's key")?;
            anyhow::ensure!(
                term < u64::MAX,
                "the term's key: after {term} there is no other. Set it anew"
            );
            Ok(term)
        };
        Ok(StoreView {
            holder: holder.transpose()?,
            term: term.as_ref().map_or(Ok(0), number)?,
            term_revision: term.map_or(0, |entry| entry.mod_revision.0),
        })
    }

    fn acquisition(&self, lease: u64, term: u64, term_revision: u64) -> anyhow::Result<Value> {
        let value = HolderValue { name: self.own.clone(), term };
        let value = BASE64.encode(serde_json::to_vec(&value)?);
        Ok(json!({
            "compare": [
                {"key": self.holder, "target": "CREATE", "result": "EQUAL", "createRevision": "0"},
                {"key": self.term, "target": "MOD", "result": "EQUAL", "modRevision": term_revision.to_string()},
            ],
            "success": [
                {"requestPut": {"key": self.holder, "value": value, "lease": lease.to_string()}},
                {"requestPut": {"key": self.term, "value": BASE64.encode(term.to_string())}},
            ],
        }))
    }

    /// Posts to the member that answered last, then to the others.
    fn post<T: DeserializeOwned>(&mut self, verb: &str, body: &Value) -> anyhow::Result<T> {
        let mut failed = anyhow!("etcd has no member");
        for _ in 0..self.endpoints.len() {
            match self.post_to(verb, body) {
                Ok(answer) => return Ok(answer),
                Err(error) if error.is::<LeaseGone>() => return Err(error),
                Err(error) => failed = error.context(self.endpoints[self.at].clone()),
            }
            // The next member needs a login of its own.
            self.token = None;
            self.at = (self.at + 1) % self.endpoints.len();
        }
        Err(failed)
    }

    fn post_to<T: DeserializeOwned>(&mut self, verb: &str, body: &Value) -> anyhow::Result<T> {
        if self.token.is_none()
            && let Some((user, password)) = &self.user
        {
            let body = json!({"name": user, "password": password});
            let answer = self.send("auth/authenticate", &body)?;
            let token = answer["token"].as_str().context("it gives no token")?;
            self.token = Some(token.to_owned());
        }
        Ok(serde_json::from_value(self.send(verb, body)?)?)
    }

    fn send(&self, verb: &str, body: &Value) -> anyhow::Result<Value> {
        let address = format!("{}/v3/{verb}", self.endpoints[self.at]);
        let request = self.agent.post(&address).config();
        let mut request = request.timeout_global(Some(self.limit)).build();
        if let Some(token) = &self.token {
            request = request.header("Authorization", token);
        }
        let bytes = serde_json::to_vec(body)?;
        let sent = request.content_type("application/json").send(&bytes[..]);
        let mut answer = sent?;
        let text = answer.body_mut().with_config().limit(MAX_BYTES).read_to_string()?;
        if answer.status() == 404 && text.contains("requested lease not found") {
            return Err(LeaseGone.into());
        }
        if !answer.status().is_success() {
            bail!("{}: {}", answer.status(), text.trim());
        }
        Ok(serde_json::from_str(&text)?)
    }
}

fn agent(settings: &LeaseSettings) -> anyhow::Result<Agent> {
    let roots = settings.ca.as_deref().map(certificates).transpose()?;
    let roots = roots.map_or(RootCerts::WebPki, |found| RootCerts::new_with_certs(&found));
    let own = settings.own.as_ref().map(|(certificate, key)| {
        let pem = joulebus_files::read_secret(key, MAX_CERTIFICATE_BYTES)?;
        let key = PrivateKey::from_pem(pem.as_bytes())?;
        Ok::<_, anyhow::Error>(ClientCert::new_with_certs(&certificates(certificate)?, key))
    });
    let tls = TlsConfig::builder().root_certs(roots);
    let config = Agent::config_builder()
        .max_redirects(0)
        .max_redirects_will_error(false)
        .http_status_as_error(false)
        .tls_config(tls.client_cert(own.transpose()?).build())
        .user_agent(concat!("joulebus/", env!("CARGO_PKG_VERSION")))
        .build();
    Ok(config.into())
}

/// Reads the certificates of a PEM file.
fn certificates(path: &Path) -> anyhow::Result<Vec<Certificate<'static>>> {
    let named = || path.display().to_string();
    let bytes = joulebus_files::read(path, MAX_CERTIFICATE_BYTES).with_context(named)?;
    let mut found = Vec::new();
    for item in parse_pem(&bytes) {
        if let PemItem::Certificate(certificate) = item.with_context(named)? {
            found.push(certificate);
        }
    }
    if found.is_empty() {
        bail!("{}: no certificate is in it, expected PEM, -----BEGIN CERTIFICATE-----", named());
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use std::io::{Read as _, Write as _};
    use std::net::{TcpListener, TcpStream};
    use std::time::Instant;

    use super::*;

    const TTL_S: u32 = 6;

    fn etcd(port: u16) -> Etcd {
        let settings = LeaseSettings {
            endpoints: vec![format!("http://127.0.0.1:{port}")],
            ttl_s: TTL_S,
            prefix: "joulebus/".to_owned(),
            ca: None,
            own: None,
            user: None,
        };
        Etcd::new(&settings, ("lab", "base")).unwrap()
    }

    /// Reads a whole request: headers, an empty line, and a body of the stated length.
    fn read_request(stream: &mut TcpStream) {
        let (mut read, mut byte) = (Vec::new(), [0]);
        while !read.ends_with(b"\r\n\r\n") && stream.read(&mut byte).unwrap_or(0) == 1 {
            read.extend_from_slice(&byte);
        }
        let text = String::from_utf8_lossy(&read).to_lowercase();
        let length = text.lines().find_map(|line| line.strip_prefix("content-length: "));
        let length = length.map_or(0, |length| length.trim().parse().unwrap());
        let _ = stream.read_exact(&mut vec![0; length]);
    }

    /// The reply to a call, and how long it took, if a member answers with `bytes` and then repeats
    /// `for_ever` while the client reads.
    fn answer(call: &Call, bytes: &[u8], for_ever: &'static [u8]) -> (Reply, Duration) {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let bytes = bytes.to_vec();
        let member = std::thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            read_request(&mut stream);
            let mut sent = stream.write_all(&bytes);
            while sent.is_ok() && !for_ever.is_empty() {
                std::thread::sleep(Duration::from_millis(5));
                sent = stream.write_all(for_ever);
            }
        });
        let asked = Instant::now();
        let reply = etcd(port).call(call);
        let took = asked.elapsed();
        member.join().unwrap();
        (reply, took)
    }

    fn ok(body: &str) -> Vec<u8> {
        let length = body.len();
        format!("HTTP/1.1 200 OK\r\nContent-Length: {length}\r\n\r\n{body}").into_bytes()
    }

    const RENEW: Call = Call::Renew { lease: 7 };

    #[test]
    fn an_answer_that_is_cut_short_odd_huge_or_endless_is_none_and_nobody_waits_longer_for_it() {
        let holder = |value: &str| {
            let value = BASE64.encode(value);
            format!(
                "{{\"responses\":[{{\"responseRange\":{{\"kvs\":[{{\"value\":\"{value}\"}}]}}}},{{\"responseRange\":{{}}}}]}}"
            )
        };
        let term = |value: &str| {
            let value = BASE64.encode(value);
            format!(
                "{{\"responses\":[{{\"responseRange\":{{}}}},{{\"responseRange\":{{\"kvs\":[{{\"value\":\"{value}\"}}]}}}}]}}"
            )
        };
        let bodies = [
            "",
            "{}",
            "[]",
            "null",
            "{\"result\":",
            "\u{feff}{}",
            "{\"error\":{\"code\":5}}",
            "not JSON",
        ];
        for call in [Call::Grant, Call::Look, RENEW] {
            for body in bodies {
                assert_eq!(answer(&call, &ok(body), b"").0, Reply::Failed, "{call:?} {body:?}");
            }
        }
        let long = format!("{{\"responses\":[{}]}}", " ".repeat(70_000));
        for (call, body) in [
            (Call::Grant, r#"{"TTL":"3"}"#),
            (Call::Grant, r#"{"ID":"7"}"#),
            (Call::Grant, r#"{"ID":"-7","TTL":"3"}"#),
            (Call::Grant, r#"{"ID":"7","TTL":"18446744073709551616"}"#),
            (Call::Grant, r#"{"ID":7.5,"TTL":3}"#),
            (Call::Grant, r#"{"ID":"0","TTL":"3"}"#),
            (Call::Grant, r#"{"ID":"7","TTL":"61"}"#),
            (Call::Grant, r#"{"ID":"7","TTL":"999999999999"}"#),
            (RENEW, r#"{"result":{"TTL":"99999999"}}"#),
            (RENEW, r#"{"result":{"TTL":"-1"}}"#),
            (RENEW, r#"{"result":{"TTL":"2"}}{"result":{"TTL":"2"}}"#),
            (Call::Look, r#"{"responses":[{"responseRange":{}}]}"#),
            (Call::Look, r#"{"responses":[{},{}]}"#),
            (Call::Look, &*holder("not JSON")),
            (Call::Look, &*holder(r#"{"name":"base"}"#)),
            (Call::Look, &*holder(r#"{"name":"base","term":-1}"#)),
            (Call::Look, &*term("seven")),
            (Call::Look, &*term("18446744073709551615")),
            (Call::Look, &*long),
        ] {
            assert_eq!(answer(&call, &ok(body), b"").0, Reply::Failed, "{body:.200}");
        }
        let good = r#"{"result":{"TTL":"2"}}"#;
        assert_eq!(answer(&RENEW, &ok(good), b"").0, Reply::Renewed { ttl_ns: 2 * NANOSECONDS });
        let gone = r#"{"error":"etcdserver: requested lease not found","code":5}"#;
        let length = gone.len();
        let gone = format!("HTTP/1.1 404 Not Found\r\nContent-Length: {length}\r\n\r\n{gone}");
        assert_eq!(answer(&RENEW, gone.as_bytes(), b"").0, Reply::Gone);
        let cut = ok(good);
        let chunked = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n";
        let limit = Duration::from_secs(TTL_S.into()) / CALL_DIVISOR;
        let cases: [(&[u8], &'static [u8]); 9] = [
            (&cut[..cut.len() - 1], b""),
            (&cut[..20], b""),
            (b"", b""),
            (b"garbage\r\n\r\n", b""),
            (
                b"HTTP/1.1 302 Found\r\nLocation: http://127.0.0.1:1/\r\nContent-Length: 0\r\n\r\n",
                b"",
            ),
            (b"HTTP/1.1 503 Busy\r\nContent-Length: 22\r\n\r\n{\"result\":{\"TTL\":\"2\"}}", b""),
            (b"HTTP/1.1 200 OK\r\n", b"X: y\r\n"),
            (chunked, b"1\r\n \r\n"),
            (b"HTTP/1.1 200 OK\r\nContent-Length: 99999999999\r\n\r\n", b" "),
        ];
        for (bytes, for_ever) in cases {
            let (reply, took) = answer(&RENEW, bytes, for_ever);
            let shown = String::from_utf8_lossy(bytes);
            assert_eq!(reply, Reply::Failed, "{shown}");
            // Generous for a busy machine. Without a limit the call would not end.
            assert!(took < 20 * limit, "{shown}: {took:?}");
        }
    }

    #[test]
    fn fields_that_are_not_known_and_keys_that_are_not_there_are_no_fault() {
        let body = r#"{"header":{"revision":"9"},"succeeded":true,"new":[1],
            "responses":[{"responseRange":{"count":"0"}},{"response_range":{}}]}"#;
        assert_eq!(answer(&Call::Look, &ok(body), b"").0, Reply::StoreView(StoreView::default()));
        let gone = r#"{"result":{"header":{},"ID":"7"}}"#;
        assert_eq!(answer(&RENEW, &ok(gone), b"").0, Reply::Renewed { ttl_ns: 0 });
    }
}
