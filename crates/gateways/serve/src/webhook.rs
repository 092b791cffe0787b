//! `joulebus serve --webhook`: posts every raise and clearance of an alarm to a web address.
//!
//! One thread reads, another sends, with a bounded queue between them. A receiver that does not
//! answer costs neither the reader nor the fleet anything. All queued changes are sent in one
//! request.

use std::path::Path;
use std::str::FromStr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, OnceLock};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::{Context as _, anyhow};
use joulebus_board::AlarmRecord;
use joulebus_bus::{Background, Running};
use joulebus_capture_recorder::host_clock;
use joulebus_config::Config;
use joulebus_consumer::FleetAlarms;
use joulebus_program::exit::UsageError;
use serde::Serialize;
use ureq::Agent;
use ureq::http::Uri;
use ureq::tls::{PemItem, RootCerts, TlsConfig, parse_pem};

/// Maximum number of changes that wait for a webhook. Further ones are lost.
const MAX_WAITING: usize = 10_000;
/// Maximum number of changes in a request to a webhook.
const MAX_CHANGES: usize = 100;
/// Time that a request may take.
const REQUEST_LIMIT: Duration = Duration::from_secs(10);
/// Pause before a request is sent again: doubled each time, up to the second.
const RETRY_DELAYS: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(60));
/// Time for what waits when the program ends.
const END_LIMIT: Duration = Duration::from_secs(5);
/// Interval of checking whether to end.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
/// Maximum size of a file with certificates, bytes. All of Mozilla's take a quarter of it.
const MAX_CERTIFICATE_BYTES: u64 = 1 << 20;

/// The report of a webhook that has ended.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct WebhookReport {
    /// Host of the address. The rest may be secret.
    pub(crate) host: String,
    /// Changes that the receiver took.
    pub(crate) told: u64,
    /// Requests that failed and were sent again, or given up.
    pub(crate) failed: u64,
    /// Changes that the receiver did not take or that the queue had no room for, and ticks without
    /// diagnostics.
    pub(crate) lost: u64,
    /// The ticks without diagnostics. Alarms that were raised and cleared within them are unknown.
    pub(crate) ticks_missed: u64,
}

/// The running threads.
pub(crate) struct Webhook {
    host: String,
    shared: Arc<Shared>,
    reading: Background<anyhow::Result<()>>,
    sending: JoinHandle<()>,
}

/// State shared by the threads.
#[derive(Debug, Default)]
struct Shared {
    /// Deadline of the queued changes, set when the program ends.
    end_by: OnceLock<Instant>,
    /// Number of changes seen. Those that are not delivered are lost.
    changes: AtomicU64,
    delivered: AtomicU64,
    failed: AtomicU64,
    /// Ticks without diagnostics.
    ticks_missed: AtomicU64,
}

impl Shared {
    /// Timeout of the next request. `None` if it is too late for one.
    fn limit(&self, now: Instant) -> Option<Duration> {
        let Some(end_by) = self.end_by.get() else {
            return Some(REQUEST_LIMIT);
        };
        let left = end_by.saturating_duration_since(now);
        (!left.is_zero()).then(|| left.min(REQUEST_LIMIT))
    }

    fn is_late(&self) -> bool {
        self.limit(Instant::now()).is_none()
    }
}

impl Webhook {
    /// Joins the fleet, and posts alarm changes from now on to `to`: an address, or `@FILE` with
    /// one (mode 0600).
    ///
    /// The receiver's certificate is checked against those of the file `authorities`, or against
    /// Mozilla's list.
    ///
    /// # Errors
    /// The address or file is wrong, or the fleet cannot be joined.
    pub(crate) fn start(
        config: &Config,
        to: &str,
        authorities: Option<&Path>,
    ) -> anyhow::Result<Self> {
        let wrong = |error: anyhow::Error| UsageError(format!("{error:#}"));
        let address = address(to).map_err(wrong)?;
        let roots = authorities.map_or(Ok(RootCerts::WebPki), certificates);
        let agent = agent(roots.map_err(wrong)?);
        let host = address.host().unwrap_or_default().to_owned();
        let (records, waiting) = sync_channel(MAX_WAITING);
        let shared = Arc::<Shared>::default();
        let (of, inside) = (config.clone(), Arc::clone(&shared));
        let (reading, ()) = Background::run("joulebus-alarms", move |thread| {
            let alarms = FleetAlarms::with_config(&of, "webhook")?;
            thread.joined(());
            read(thread, alarms, of.fleet(), &records, &inside)
        })?;
        let (fleet, inside) = (config.fleet().to_owned(), Arc::clone(&shared));
        let thread = thread::Builder::new().name("joulebus-webhook".to_owned());
        let sending =
            thread.spawn(move || Sending::new(fleet, address, agent, inside).run(&waiting))?;
        Ok(Self { host, shared, reading, sending })
    }

    /// Host of the receiver.
    pub(crate) fn host(&self) -> &str {
        &self.host
    }

    /// Whether it has ended by itself. [`Webhook::finish`] returns the reason.
    pub(crate) fn is_over(&self) -> bool {
        self.reading.has_ended()
    }

    /// Delivers the queued changes within five seconds, and leaves the fleet.
    ///
    /// # Errors
    /// The reason for which it ended early.
    pub(crate) fn finish(self) -> anyhow::Result<WebhookReport> {
        let shared = &self.shared;
        // No other call sets it.
        let _ = shared.end_by.set(Instant::now() + END_LIMIT);
        let read = self.reading.join();
        while !self.sending.is_finished() && !shared.is_late() {
            thread::sleep(POLL_INTERVAL);
        }
        // Otherwise the thread waits for the answer to a request that was sent before the end. It
        // ends with the process.
        if self.sending.is_finished() {
            let panicked = |_| anyhow!("a thread of --webhook panicked");
            self.sending.join().map_err(panicked)?;
        }
        read?;
        let count = |count: &AtomicU64| count.load(Ordering::Relaxed);
        let (told, ticks_missed) = (count(&shared.delivered), count(&shared.ticks_missed));
        let untold = count(&shared.changes).saturating_sub(told);
        Ok(WebhookReport {
            host: self.host,
            told,
            failed: count(&shared.failed),
            lost: untold + ticks_missed,
            ticks_missed,
        })
    }
}

/// The address that `--webhook` means.
fn address(to: &str) -> anyhow::Result<Uri> {
    let text = match to.strip_prefix('@') {
        Some(path) => joulebus_files::read_secret_line(Path::new(path))
            .with_context(|| format!("--webhook {to}"))?,
        None => to.to_owned(),
    };
    let refused =
        "--webhook: expected an address such as https://host.example/path, or @FILE with one";
    let address = Uri::from_str(text.trim()).context(refused)?;
    let authority = address.authority();
    let named = authority.map_or("", |authority| authority.as_str());
    let (host, port) = (address.host().unwrap_or_default(), address.port_u16());
    if port.is_none_or(|port| port == 0)
        && named.rsplit_once(host).is_some_and(|(_, rest)| rest.starts_with(':'))
    {
        return Err(anyhow!("--webhook {named}: a port is 1 to 65535"));
    }
    let is_http = matches!(address.scheme_str(), Some("http" | "https"));
    if is_http && address.host().is_some_and(|host| !host.is_empty()) {
        return Ok(address);
    }
    Err(anyhow!(refused))
}

/// The certificates in a file.
fn certificates(path: &Path) -> anyhow::Result<RootCerts> {
    let named = || format!("--webhook-ca {}", path.display());
    let bytes = joulebus_files::read(path, MAX_CERTIFICATE_BYTES).with_context(named)?;
    let mut found = Vec::new();
    for item in parse_pem(&bytes) {
        if let PemItem::Certificate(certificate) = item.with_context(named)? {
            found.push(certificate);
        }
    }
    if found.is_empty() {
        let expected = "no certificate is in it, expected PEM, -----BEGIN CERTIFICATE-----";
        return Err(anyhow!(expected)).with_context(named);
    }
    Ok(RootCerts::new_with_certs(&found))
}

/// The HTTP client.
fn agent(roots: RootCerts) -> Agent {
    let config = Agent::config_builder()
        // A redirect would reveal the address to another host.
        .max_redirects(0)
        .max_redirects_will_error(false)
        .http_status_as_error(false)
        .tls_config(TlsConfig::builder().root_certs(roots).build())
        .user_agent(concat!("joulebus/", env!("CARGO_PKG_VERSION")))
        .build();
    config.into()
}

/// Queues every change until a stop is requested.
fn read(
    thread: &Running,
    mut alarms: FleetAlarms,
    fleet: &str,
    records: &SyncSender<AlarmRecord>,
    shared: &Shared,
) -> anyhow::Result<()> {
    let clock = host_clock();
    while !thread.is_stopping() {
        alarms.wait(|change| {
            let record = AlarmRecord::new(fleet, &change, clock.unix_ns(change.at_ns));
            shared.changes.fetch_add(1, Ordering::Relaxed);
            // Without room the change is lost.
            let _ = records.try_send(record);
        })?;
    }
    let missed = alarms.history().ticks_missed();
    shared.ticks_missed.store(missed, Ordering::Relaxed);
    Ok(())
}

/// The body of a request.
#[derive(Serialize)]
struct Body<'a> {
    fleet: &'a str,
    changes: &'a [AlarmRecord],
}

/// The result of a request.
enum Answer {
    Taken,
    /// Sending it again may help.
    Later(String),
    /// The receiver refused it.
    Refused(String),
}

struct Sending {
    fleet: String,
    address: Uri,
    agent: Agent,
    shared: Arc<Shared>,
}

impl Sending {
    const fn new(fleet: String, address: Uri, agent: Agent, shared: Arc<Shared>) -> Self {
        Self { fleet, address, agent, shared }
    }

    /// Sends until the reader has ended and nothing waits, or the time is over.
    fn run(self, waiting: &Receiver<AlarmRecord>) {
        let mut changes = Vec::new();
        loop {
            match waiting.recv_timeout(POLL_INTERVAL) {
                Ok(change) => changes.push(change),
                Err(RecvTimeoutError::Timeout) => continue,
                Err(RecvTimeoutError::Disconnected) => return,
            }
            while changes.len() < MAX_CHANGES
                && let Ok(change) = waiting.try_recv()
            {
                changes.push(change);
            }
            self.deliver(&changes);
            changes.clear();
        }
    }

    /// Sends changes until the receiver has taken or refused them, or the time is over.
    fn deliver(&self, changes: &[AlarmRecord]) {
        let count = changes.len() as u64;
        let mut pause = RETRY_DELAYS.0;
        while let Some(limit) = self.shared.limit(Instant::now()) {
            let why = match self.send(changes, limit) {
                Answer::Taken => {
                    self.shared.delivered.fetch_add(count, Ordering::Relaxed);
                    return;
                }
                Answer::Refused(why) => {
                    self.shared.failed.fetch_add(1, Ordering::Relaxed);
                    tracing::warn!(
                        changes = count,
                        "--webhook: refused, and not sent again: {why}"
                    );
                    return;
                }
                Answer::Later(why) => why,
            };
            self.shared.failed.fetch_add(1, Ordering::Relaxed);
            let pause_s = pause.as_secs_f64();
            tracing::warn!(changes = count, pause_s, "--webhook: sent again after a pause: {why}");
            if !self.pauses(pause) {
                return;
            }
            pause = (pause * 2).min(RETRY_DELAYS.1);
        }
    }

    fn send(&self, changes: &[AlarmRecord], limit: Duration) -> Answer {
        let body = Body { fleet: &self.fleet, changes };
        let bytes = match serde_json::to_vec(&body) {
            Ok(bytes) => bytes,
            Err(error) => return Answer::Refused(error.to_string()),
        };
        let request = self.agent.post(&self.address).config();
        let request = request.timeout_global(Some(limit)).build();
        let sent = request.content_type("application/json").send(&bytes[..]);
        match sent.map(|response| response.status()) {
            Ok(status) if status.is_success() => Answer::Taken,
            Ok(status)
                if status.is_server_error() || [408, 425, 429].contains(&status.as_u16()) =>
            {
                Answer::Later(status.to_string())
            }
            Ok(status) => Answer::Refused(status.to_string()),
            Err(error) => Answer::Later(error.to_string()),
        }
    }

    /// Waits before the next attempt. False if there is no time for one.
    fn pauses(&self, pause: Duration) -> bool {
        let until = Instant::now() + pause;
        loop {
            let now = Instant::now();
            if self.shared.end_by.get().is_some_and(|end_by| until > *end_by) {
                return false;
            }
            if now >= until {
                return true;
            }
            thread::sleep(POLL_INTERVAL.min(until - now));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_addresses_of_the_web_are_taken() {
        for good in ["http://127.0.0.1:9/x", "https://hooks.example/T0/secret?a=b"] {
            assert_eq!(address(good).unwrap().to_string(), good);
        }
        for bad in [
            "",
            "hooks.example/x",
            "ftp://host/x",
            "file:///etc/passwd",
            "http://",
            "@/nowhere",
            "https://host.example:70000/x",
            "https://host.example:0/x",
            "http://[::1]:99999/",
        ] {
            assert!(address(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn what_waits_has_five_seconds_whatever_the_receiver_does() {
        let (shared, now) = (Arc::<Shared>::default(), Instant::now());
        assert_eq!(shared.limit(now), Some(REQUEST_LIMIT));
        shared.end_by.set(now + END_LIMIT).unwrap();
        assert_eq!(shared.limit(now), Some(END_LIMIT));
        let seconds = Duration::from_secs;
        assert_eq!(shared.limit(now + seconds(3)), Some(seconds(2)));
        assert_eq!(shared.limit(now + END_LIMIT), None);
        assert_eq!(shared.limit(now + seconds(60)), None);
    }

    #[test]
    fn nothing_is_sent_after_the_end() {
        // This receiver never answers.
        let receiver = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let to = format!("http://{}/x", receiver.local_addr().unwrap());
        let shared = Arc::<Shared>::default();
        shared.end_by.set(Instant::now()).unwrap();
        let (records, waiting) = sync_channel(MAX_WAITING);
        for number in 0..MAX_WAITING {
            let record = AlarmRecord {
                fleet: "lab".to_owned(),
                stamp_ns: number as u64,
                robot: Some(1),
                alarm: "NoData",
                level: "stale",
                change: "raised",
                lasted_s: None,
                acknowledged: None,
                card: None,
            };
            records.send(record).unwrap();
        }
        drop(records);
        let (agent, to) = (agent(RootCerts::WebPki), address(&to).unwrap());
        Sending::new("lab".to_owned(), to, agent, Arc::clone(&shared)).run(&waiting);
        receiver.set_nonblocking(true).unwrap();
        assert!(receiver.accept().is_err(), "a request was sent");
    }
}
