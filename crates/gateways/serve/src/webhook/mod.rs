//! `joulebus serve --webhook` and `--webhooks`: posts every raise and end of an alarm to web
//! addresses.
//!
//! One thread reads, and each receiver has one that sends, with a bounded queue between them. A
//! receiver that does not answer costs neither the reader nor the fleet anything. All queued
//! changes are sent in one request.

mod body;
mod receiver;
mod signature;

use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver as Queue, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, OnceLock};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::anyhow;
use joulebus_board::AlarmRecord;
use joulebus_bus::{Background, Rounds, clock};
use joulebus_capture_format::Clock;
use joulebus_capture_recorder::host_clock;
use joulebus_config::Config;
use joulebus_consumer::FleetAlarms;
use joulebus_program::exit::UsageError;
use serde::Serialize;

use receiver::Receiver;

/// Maximum number of queued changes. Further ones are lost.
const MAX_WAITING: usize = 10_000;
/// Maximum number of changes in a request.
const MAX_CHANGES: usize = 100;
/// Timeout of a request.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(10);
/// Pause before a request is sent again: doubled each time, up to the second.
const RETRY_DELAYS: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(60));
/// Maximum pause that a receiver can ask for.
const MAX_ASKED_PAUSE: Duration = Duration::from_secs(3_600);
/// Timeout of the messages that wait when the program ends.
const END_TIMEOUT: Duration = Duration::from_secs(5);
/// Interval of checking whether to end.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

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

pub(crate) struct Webhooks {
    shared: Arc<Shared>,
    reading: Background<anyhow::Result<()>>,
    sending: Vec<(Arc<Counts>, JoinHandle<()>)>,
}

/// State shared by the threads.
#[derive(Debug, Default)]
struct Shared {
    /// Deadline of what waits, set when the program ends.
    end_by: OnceLock<Instant>,
    /// Number of changes seen. Those that are not delivered are lost.
    changes: AtomicU64,
    ticks_missed: AtomicU64,
}

/// The host of a receiver, and counts of the requests to it by outcome.
#[derive(Debug)]
struct Counts {
    host: String,
    delivered: AtomicU64,
    failed: AtomicU64,
}

impl Shared {
    /// Timeout of the next request. `None` if it is too late for one.
    fn timeout(&self, now: Instant) -> Option<Duration> {
        let Some(end_by) = self.end_by.get() else {
            return Some(REQUEST_TIMEOUT);
        };
        let left = end_by.saturating_duration_since(now);
        (!left.is_zero()).then(|| left.min(REQUEST_TIMEOUT))
    }

    fn is_late(&self) -> bool {
        self.timeout(Instant::now()).is_none()
    }
}

impl Webhooks {
    /// Joins the fleet, and sends receivers the alarm changes from now on: `to`, an address or
    /// `@FILE` with one, and those in the file `listed`.
    ///
    /// # Errors
    /// An address or file is wrong, or the fleet cannot be joined.
    pub(crate) fn start(
        config: &Config,
        to: Option<&str>,
        listed: Option<&Path>,
    ) -> anyhow::Result<Self> {
        let named = to.map(Receiver::named).transpose();
        let named = named.map_err(|error| UsageError(format!("{error:#}")))?;
        let mut receivers = listed.map_or(Ok(Vec::new()), Receiver::read)?;
        receivers.extend(named);
        let shared = Arc::<Shared>::default();
        let (mut queues, mut sending) = (Vec::new(), Vec::new());
        for receiver in receivers {
            let sender = Sending::new(config.fleet().to_owned(), receiver, Arc::clone(&shared));
            let counts = Arc::clone(&sender.counts);
            let (records, waiting) = sync_channel(MAX_WAITING);
            queues.push(records);
            let thread = thread::Builder::new().name("joulebus-webhook".to_owned());
            sending.push((counts, thread.spawn(move || sender.run(&waiting))?));
        }
        let (config, inside) = (config.clone(), Arc::clone(&shared));
        let reading = Background::repeat("joulebus-alarms", move || {
            let alarms = FleetAlarms::with_config(&config, "webhook")?;
            let (clock, fleet) = (host_clock(), config.fleet().to_owned());
            Ok((Reading { alarms, clock, fleet, queues, shared: inside }, ()))
        });
        let (reading, ()) = reading?;
        Ok(Self { shared, reading, sending })
    }

    /// Hosts of the receivers.
    pub(crate) fn hosts(&self) -> String {
        let hosts: Vec<&str> =
            self.sending.iter().map(|(counts, _)| counts.host.as_str()).collect();
        hosts.join(", ")
    }

    /// True if it has ended by itself. [`Webhooks::finish`] returns the reason.
    pub(crate) fn is_over(&self) -> bool {
        self.reading.has_ended()
    }

    /// Delivers what waits within five seconds, and leaves the fleet.
    pub(crate) fn finish(self) -> anyhow::Result<Vec<WebhookReport>> {
        let shared = &self.shared;
        // No other call sets it.
        let _ = shared.end_by.set(Instant::now() + END_TIMEOUT);
        let read = self.reading.join();
        let (changes, ticks_missed) =
            (shared.changes.load(Ordering::Relaxed), shared.ticks_missed.load(Ordering::Relaxed));
        let mut reports = Vec::new();
        for (counts, thread) in self.sending {
            while !thread.is_finished() && !shared.is_late() {
                thread::sleep(POLL_INTERVAL);
            }
            // Otherwise the thread waits for the answer to a request that was sent before the end.
            // It ends with the process.
            if thread.is_finished() {
                thread.join().map_err(|_| anyhow!("a thread of --webhook panicked"))?;
            }
            let told = counts.delivered.load(Ordering::Relaxed);
            reports.push(WebhookReport {
                host: counts.host.clone(),
                told,
                failed: counts.failed.load(Ordering::Relaxed),
                lost: changes.saturating_sub(told) + ticks_missed,
                ticks_missed,
            });
        }
        read?;
        Ok(reports)
    }
}

/// State of the thread that passes every change on.
struct Reading {
    alarms: FleetAlarms,
    clock: Clock,
    fleet: String,
    /// One for each receiver.
    queues: Vec<SyncSender<AlarmRecord>>,
    shared: Arc<Shared>,
}

impl Rounds<(), anyhow::Error> for Reading {
    fn round(&mut self) -> anyhow::Result<Duration> {
        self.alarms.wait(|change| {
            let record = AlarmRecord::new(&self.fleet, &change, self.clock.unix_ns(change.at_ns));
            self.shared.changes.fetch_add(1, Ordering::Relaxed);
            for records in &self.queues {
                // Without room the change is lost.
                drop(records.try_send(record.clone()));
            }
        })?;
        Ok(Duration::ZERO)
    }

    fn finish(self) -> anyhow::Result<()> {
        let missed = self.alarms.history().ticks_missed();
        self.shared.ticks_missed.store(missed, Ordering::Relaxed);
        Ok(())
    }
}

/// The result of a request.
enum Answer {
    Taken,
    /// Sending it again may help, after the pause for which the receiver asks.
    Later(String, Option<Duration>),
    /// The receiver refused it.
    Refused(String),
}

struct Sending {
    fleet: String,
    receiver: Receiver,
    shared: Arc<Shared>,
    counts: Arc<Counts>,
    /// Begins the ids of requests: names the process and its thread.
    start_ns: u64,
    requests: AtomicU64,
}

impl Sending {
    fn new(fleet: String, receiver: Receiver, shared: Arc<Shared>) -> Self {
        let host = receiver.host().to_owned();
        let counts = Counts { host, delivered: AtomicU64::new(0), failed: AtomicU64::new(0) };
        let (counts, start_ns) = (Arc::new(counts), clock::unix_ns());
        Self { fleet, receiver, shared, counts, start_ns, requests: AtomicU64::new(0) }
    }

    /// Sends changes until the reader has ended and nothing waits, or the time is over.
    fn run(self, waiting: &Queue<AlarmRecord>) {
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
            if self.deliver(&changes) {
                self.counts.delivered.fetch_add(changes.len() as u64, Ordering::Relaxed);
            }
            changes.clear();
        }
    }

    /// Sends the changes until the receiver has taken or refused them, or the time is over. Whether
    /// they were taken.
    fn deliver(&self, changes: &[AlarmRecord]) -> bool {
        let body = body::body(&self.fleet, changes, self.receiver.page.as_deref()).to_string();
        let count = changes.len();
        let number = self.requests.fetch_add(1, Ordering::Relaxed);
        let id = format!("msg_{:x}_{number}", self.start_ns);
        let host = &self.counts.host;
        let mut pause = RETRY_DELAYS.0;
        while let Some(timeout) = self.shared.timeout(Instant::now()) {
            let (why, asked) = match self.send(&id, body.as_bytes(), timeout) {
                Answer::Taken => return true,
                Answer::Refused(why) => {
                    self.counts.failed.fetch_add(1, Ordering::Relaxed);
                    tracing::warn!(
                        changes = count,
                        host,
                        "--webhook: refused, and not sent again: {why}"
                    );
                    return false;
                }
                Answer::Later(why, asked) => (why, asked),
            };
            let wait = pause.max(asked.unwrap_or_default());
            self.counts.failed.fetch_add(1, Ordering::Relaxed);
            let pause_s = wait.as_secs_f64();
            tracing::warn!(
                changes = count,
                host,
                pause_s,
                "--webhook: sent again after a pause: {why}"
            );
            if !self.pauses(wait) {
                break;
            }
            pause = (pause * 2).min(RETRY_DELAYS.1);
        }
        false
    }

    fn send(&self, id: &str, body: &[u8], timeout: Duration) -> Answer {
        let request = self.receiver.agent.post(&self.receiver.address).config();
        let mut request = request.timeout_global(Some(timeout)).build();
        if let Some(signer) = &self.receiver.signer {
            let unix_s = clock::unix_ns() / 1_000_000_000;
            request = request.header("webhook-id", id);
            request = request.header("webhook-timestamp", unix_s.to_string());
            request = request.header("webhook-signature", signer.sign(id, unix_s, body));
        }
        let sent = request.content_type("application/json").send(body);
        let response = match sent {
            Ok(response) => response,
            Err(error) => return Answer::Later(error.to_string(), None),
        };
        let status = response.status();
        if status.is_success() {
            return Answer::Taken;
        }
        if !status.is_server_error() && ![408, 425, 429].contains(&status.as_u16()) {
            return Answer::Refused(status.to_string());
        }
        let asked = response.headers().get("retry-after").and_then(|value| value.to_str().ok());
        Answer::Later(status.to_string(), asked.and_then(asked_pause))
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

/// The pause that a receiver asks for by `Retry-After`, in seconds. Its other form, a date, is of
/// another host's clock.
fn asked_pause(text: &str) -> Option<Duration> {
    let seconds = text.trim().parse().ok()?;
    Some(Duration::from_secs(seconds).min(MAX_ASKED_PAUSE))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_receiver_may_ask_for_a_pause_of_an_hour_at_most() {
        for (text, seconds) in [("0", Some(0)), (" 120 ", Some(120)), ("86400", Some(3_600))] {
            assert_eq!(asked_pause(text), seconds.map(Duration::from_secs), "{text}");
        }
        for text in ["", "-1", "1.5", "Fri, 27 Nov 2026 01:00:00 GMT", "99999999999999999999"] {
            assert_eq!(asked_pause(text), None, "{text}");
        }
    }

    #[test]
    fn what_waits_has_five_seconds_whatever_the_receiver_does() {
        let (shared, now) = (Arc::<Shared>::default(), Instant::now());
        assert_eq!(shared.timeout(now), Some(REQUEST_TIMEOUT));
        shared.end_by.set(now + END_TIMEOUT).unwrap();
        assert_eq!(shared.timeout(now), Some(END_TIMEOUT));
        let seconds = Duration::from_secs;
        assert_eq!(shared.timeout(now + seconds(3)), Some(seconds(2)));
        assert_eq!(shared.timeout(now + END_TIMEOUT), None);
        assert_eq!(shared.timeout(now + seconds(60)), None);
    }

    #[test]
    fn nothing_is_sent_after_the_end() {
        // This receiver never answers.
        let receiver = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let to = format!("http://{}/x", receiver.local_addr().unwrap());
        let shared = Arc::<Shared>::default();
        shared.end_by.set(Instant::now()).unwrap();
        let (records, waiting) = sync_channel(MAX_WAITING);
        for _ in 0..MAX_WAITING {
            records.send(body::tests::raised("NoData")).unwrap();
        }
        drop(records);
        let to = Receiver::named(&to).unwrap();
        Sending::new("lab".to_owned(), to, Arc::clone(&shared)).run(&waiting);
        receiver.set_nonblocking(true).unwrap();
        assert!(receiver.accept().is_err(), "a request was sent");
    }
}
