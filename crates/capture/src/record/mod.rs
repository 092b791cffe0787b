//! Records fleets: a thread that empties shared memory, a queue of bounded size, a thread that
//! encodes, compresses and writes.
//!
//! A slow disk fills the queue; when it is full, messages are lost and counted, and neither the
//! worker nor its planners notice. A full disk ends the capture with its reason, and what was written
//! can be recovered.
//!
//! A process can be in one fleet's shared memory only. Other fleets come as streams: captures
//! written to a pipe by processes of their own.

mod drain;
mod files;
mod gaps;
mod queue;

use std::collections::BTreeMap;
use std::fmt;
use std::io::Read;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use joulebus_bus::clock;
use joulebus_config::Config;

use crate::{
    Attachments, CaptureSettings, Clock, Message, MessageKind, Reader, Times, WriteError, Written,
};
use drain::Drain;
use files::Files;
use gaps::Gaps;
use queue::{Popped, Queue};

pub use drain::DrainError;
pub use files::Target;

/// For how long the writing thread waits before it looks whether a chunk is due.
const PATIENCE: Duration = Duration::from_millis(10);
/// How often a running recording tells what it has come to, ns.
const NOTE_EVERY_NS: u64 = 500_000_000;

/// How to record.
#[derive(Clone)]
pub struct Options {
    /// How files are written.
    pub settings: CaptureSettings,
    /// Channels for single robots as well, for plots.
    pub per_robot: bool,
    /// Which topics are recorded.
    pub choose: Arc<dyn Fn(&str) -> bool + Send + Sync>,
    /// A file that has become this long in bytes is ended, and the next one begun.
    pub max_file_bytes: u64,
    /// A file that spans this time is ended, and the next one begun, ns. The index of a file is kept
    /// in memory until its end: about 30 MB an hour.
    pub max_file_ns: u64,
    /// Where the file exists, the next part that does not is begun, instead of an error.
    pub go_on: bool,
    /// Keep the last seconds in memory instead of writing everything.
    pub snapshot: Option<Snapshot>,
    /// Messages that wait for the disk, bytes in memory; those that come on top are lost.
    pub queue_bytes: usize,
}

impl fmt::Debug for Options {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("Options")
            .field("settings", &self.settings)
            .field("per_robot", &self.per_robot)
            .field("max_file_bytes", &self.max_file_bytes)
            .field("max_file_ns", &self.max_file_ns)
            .field("go_on", &self.go_on)
            .field("snapshot", &self.snapshot)
            .field("queue_bytes", &self.queue_bytes)
            .finish_non_exhaustive()
    }
}

/// What is kept in memory, and when it is written down.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Snapshot {
    /// How far back it goes, ns.
    pub keep_ns: u64,
    /// Bytes that it takes at most; then it goes back less far.
    pub max_bytes: usize,
    /// Written down when a robot raises an alarm that it did not raise before, and not only when
    /// asked for.
    pub on_alarm: bool,
}

impl Default for Options {
    /// Everything in files of an hour, 128 MiB of patience with the disk.
    fn default() -> Self {
        Self {
            settings: CaptureSettings::default(),
            per_robot: false,
            choose: Arc::new(|_| true),
            max_file_bytes: u64::MAX,
            max_file_ns: 3_600_000_000_000,
            go_on: false,
            snapshot: None,
            queue_bytes: 128 << 20,
        }
    }
}

/// A message on its way.
#[derive(Debug)]
pub(crate) struct Item {
    pub(crate) fleet: Arc<str>,
    pub(crate) times: Times,
    pub(crate) message: Message,
}

impl Item {
    fn topic(&self) -> String {
        let kind = self.message.kind();
        kind.map_or_else(String::new, |kind| kind.topic(&self.fleet, 0))
    }

    /// What it takes in memory, about.
    pub(crate) fn bytes(&self) -> usize {
        let rows = match &self.message {
            Message::Samples(_, rows) => size_of_val(rows.as_slice()),
            Message::Forecasts(_, rows) => size_of_val(rows.as_slice()),
            Message::Diagnostics(_, rows) => size_of_val(rows.as_slice()),
            Message::Budgets(_, rows) => size_of_val(rows.as_slice()),
            Message::Ticks(_, rows) => size_of_val(rows.as_slice()),
            Message::State(_, bytes) => bytes.len(),
            _ => 0,
        };
        size_of::<Self>() + rows
    }
}

/// What a topic lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Lost {
    /// Messages overwritten in shared memory before the recorder came round to them.
    pub overwritten: u64,
    /// Messages that found the queue full: the disk was too slow.
    pub unwritten: u64,
}

/// What a recording has come to.
#[derive(Debug, Clone, Default)]
pub struct Summary {
    /// Files, with what is in them.
    pub files: Vec<(PathBuf, Written)>,
    /// What was lost, by topic; topics that lost nothing are left out.
    pub lost: BTreeMap<String, Lost>,
    /// Why it stopped by itself, if it did.
    pub failure: Option<String>,
}

impl Summary {
    /// Messages in all files.
    #[must_use]
    pub fn messages(&self) -> u64 {
        self.files.iter().map(|(_, written)| written.messages).sum()
    }

    /// Bytes of all files.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.files.iter().map(|(_, written)| written.bytes).sum()
    }

    /// Messages lost.
    #[must_use]
    pub fn messages_lost(&self) -> u64 {
        let lost = self.lost.values();
        lost.map(|lost| lost.overwritten + lost.unwritten).sum()
    }
}

/// Why a recording could not begin.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StartError {
    /// The fleet's services could not be opened.
    #[error(transparent)]
    Drain(#[from] DrainError),
    /// The file could not be begun.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// More channels than a file can have.
    #[error(
        "channels for single robots: fleet {fleet} has room for {robots} robots, that is {needed} \
         channels, and a file can have {allowed}; record fewer topics, or without them"
    )]
    TooManyChannels {
        /// The fleet.
        fleet: String,
        /// Robots that it has room for.
        robots: u64,
        /// Channels needed.
        needed: u64,
        /// Channels that a file can have.
        allowed: u64,
    },
    /// A thread could not be started, or died at its start.
    #[error("the recorder cannot start: {0}")]
    Thread(#[from] std::io::Error),
}

/// A recording that runs.
#[derive(Debug)]
pub struct Recorder {
    shared: Arc<Shared>,
    feeds: Vec<JoinHandle<()>>,
    writer: Option<JoinHandle<()>>,
}

/// What the threads share.
#[derive(Debug)]
pub(crate) struct Shared {
    stop: AtomicBool,
    write_down: AtomicBool,
    over: AtomicBool,
    queue: Queue,
    gaps: Mutex<(Gaps, BTreeMap<String, Lost>)>,
    summary: Mutex<Summary>,
}

impl Recorder {
    /// Begins: joins the fleet of `config`, opens the file, and records from now on. What is in
    /// `streams` are captures as they are written by others, of other fleets.
    ///
    /// # Errors
    /// [`StartError`]; nothing is left but perhaps an empty file.
    pub fn start(
        config: &Config,
        streams: Vec<Box<dyn Read + Send>>,
        clock: Clock,
        attachments: Attachments,
        target: Target,
        options: &Options,
    ) -> Result<Self, StartError> {
        check_channels(config, options)?;
        let files = Files::begin(target, attachments, options.clone())?;
        let shared = Arc::new(Shared {
            stop: AtomicBool::new(false),
            write_down: AtomicBool::new(false),
            over: AtomicBool::new(false),
            queue: Queue::new(options.queue_bytes),
            gaps: Mutex::new((Gaps::new(clock::unix_ns()), BTreeMap::new())),
            summary: Mutex::default(),
        });
        let mut recorder = Self {
            shared,
            feeds: Vec::new(),
            writer: None,
        };
        recorder.start_drain(config, clock, options)?;
        for stream in streams {
            recorder.start_stream(stream, clock)?;
        }
        let shared = Arc::clone(&recorder.shared);
        recorder.writer = Some(spawn("joulebus-write", move || {
            write(files, &shared, clock);
        })?);
        Ok(recorder)
    }

    /// Writes down what is kept in memory, if this is a snapshot.
    pub fn write_down(&self) {
        self.shared.write_down.store(true, Ordering::Relaxed);
    }

    /// Whether it has stopped by itself: the file could not be written.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.shared.over.load(Ordering::Relaxed)
    }

    /// What it has come to so far.
    #[must_use]
    pub fn summary(&self) -> Summary {
        self.shared.summary()
    }

    /// Takes what waits in shared memory, ends the file and says what the recording has come to.
    #[must_use]
    pub fn finish(mut self) -> Summary {
        self.stop();
        self.shared.summary()
    }

    fn start_drain(
        &mut self,
        config: &Config,
        clock: Clock,
        options: &Options,
    ) -> Result<(), StartError> {
        let (shared, config) = (Arc::clone(&self.shared), config.clone());
        let options = options.clone();
        let (ready, started) = sync_channel(1);
        let drain = spawn("joulebus-drain", move || {
            match Drain::open(&config, clock, |kind| options.wants(kind, config.fleet())) {
                Ok(drain) => {
                    // Whoever started us waits on the other end.
                    let _ = ready.send(Ok(()));
                    drain.work(&shared);
                }
                Err(error) => {
                    let _ = ready.send(Err(error));
                }
            }
        })?;
        self.feeds.push(drain);
        let opened = started
            .recv()
            .map_err(|_| std::io::Error::other("the thread that drains shared memory died"))?;
        Ok(opened?)
    }

    fn start_stream(
        &mut self,
        stream: Box<dyn Read + Send>,
        clock: Clock,
    ) -> Result<(), StartError> {
        let shared = Arc::clone(&self.shared);
        let feed = spawn("joulebus-stream", move || {
            if let Err(error) = pass_on(stream, clock, &shared) {
                shared.note_failure(format!("another fleet's capture broke off: {error}"));
            }
        })?;
        self.feeds.push(feed);
        Ok(())
    }

    fn stop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        for feed in self.feeds.drain(..) {
            if feed.join().is_err() {
                tracing::error!("a thread of the recorder panicked");
            }
        }
        self.shared.queue.close();
        if let Some(writer) = self.writer.take()
            && writer.join().is_err()
        {
            self.shared
                .fail("the thread that writes panicked".to_owned());
        }
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.stop();
    }
}

impl Options {
    /// Whether a service of the fleet is needed for any topic that is recorded.
    fn wants(&self, kind: MessageKind, fleet: &str) -> bool {
        let choose = &self.choose;
        let on_alarm = self.snapshot.is_some_and(|snapshot| snapshot.on_alarm);
        let alarms = on_alarm && kind == MessageKind::Diagnostics;
        // The journal tells which diagnostics were never sent.
        let diagnostics = kind == MessageKind::Ticks && self.wants(MessageKind::Diagnostics, fleet);
        choose(&kind.topic(fleet, 0)) || self.per_robot || alarms || diagnostics
    }
}

impl Shared {
    pub(crate) fn is_stopping(&self) -> bool {
        self.stop.load(Ordering::Relaxed) || self.queue.is_closed()
    }

    /// Puts the item into the queue; counts what is missing before it, and it if it is lost.
    pub(crate) fn hand_on(&self, item: Item) {
        let found = {
            let mut gaps = self.gaps.lock().unwrap_or_else(PoisonError::into_inner);
            gaps.0.look(&item.fleet, &item.message)
        };
        let topic = item.topic();
        let diagnostics = MessageKind::Diagnostics.topic(&item.fleet, 0);
        let unwritten = (!self.queue.push(item)).into();
        self.count(topic, found.missing, unwritten);
        if found.never_sent > 0 {
            self.forgive(&diagnostics, found.never_sent);
        }
    }

    fn forgive(&self, topic: &str, never_sent: u64) {
        let mut gaps = self.gaps.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(lost) = gaps.1.get_mut(topic) {
            lost.overwritten = lost.overwritten.saturating_sub(never_sent);
            if *lost == Lost::default() {
                gaps.1.remove(topic);
            }
        }
    }

    fn count(&self, topic: String, overwritten: u64, unwritten: u64) {
        if overwritten + unwritten > 0 {
            let mut gaps = self.gaps.lock().unwrap_or_else(PoisonError::into_inner);
            let lost = gaps.1.entry(topic).or_default();
            lost.overwritten += overwritten;
            lost.unwritten += unwritten;
        }
    }

    fn summary(&self) -> Summary {
        let summary = self.summary.lock().unwrap_or_else(PoisonError::into_inner);
        let gaps = self.gaps.lock().unwrap_or_else(PoisonError::into_inner);
        Summary {
            lost: gaps.1.clone(),
            ..summary.clone()
        }
    }

    fn note_files(&self, files: &Files) {
        let mut summary = self.summary.lock().unwrap_or_else(PoisonError::into_inner);
        summary.files = files.written();
    }

    fn note_failure(&self, reason: String) {
        let mut summary = self.summary.lock().unwrap_or_else(PoisonError::into_inner);
        summary.failure.get_or_insert(reason);
    }

    /// Ends everything: what comes from now on is lost, and counted.
    fn fail(&self, reason: String) {
        self.note_failure(reason);
        self.over.store(true, Ordering::Relaxed);
        self.queue.close();
    }
}

/// A file holds so many channels: whether those of all robots fit is known before the first.
fn check_channels(config: &Config, options: &Options) -> Result<(), StartError> {
    let robots = u64::from(config.settings().capacity);
    let needed = MessageKind::OF_FLEET.len() as u64 + 4 * robots;
    let allowed = crate::writer::MOST_CHANNELS as u64;
    if options.per_robot && needed > allowed {
        return Err(StartError::TooManyChannels {
            fleet: config.fleet().to_owned(),
            robots,
            needed,
            allowed,
        });
    }
    Ok(())
}

fn spawn(name: &str, work: impl FnOnce() + Send + 'static) -> std::io::Result<JoinHandle<()>> {
    let builder = std::thread::Builder::new().name(name.to_owned());
    builder.spawn(work)
}

/// The thread that writes: until the queue is closed and empty, or the file cannot be written.
fn write(mut files: Files, shared: &Shared, clock: Clock) {
    let worked = work(&mut files, shared, clock);
    let ended = worked.and_then(|()| files.end());
    if let Err(error) = ended {
        shared.fail(error.to_string());
        while let Popped::Item(item) = shared.queue.pop(Duration::ZERO) {
            shared.count(item.topic(), 0, 1);
        }
    }
    shared.note_files(&files);
}

fn work(files: &mut Files, shared: &Shared, clock: Clock) -> Result<(), WriteError> {
    let mut note_from_ns = 0;
    loop {
        if shared.write_down.swap(false, Ordering::Relaxed) {
            files.write_down()?;
        }
        match shared.queue.pop(PATIENCE) {
            Popped::Item(item) => {
                let topic = item.topic();
                files
                    .take(item)
                    .inspect_err(|_| shared.count(topic, 0, 1))?;
            }
            Popped::Nothing => {}
            Popped::Closed => return Ok(()),
        }
        let now_ns = clock::monotonic_ns();
        files.look(clock.unix_ns(now_ns))?;
        if now_ns >= note_from_ns {
            note_from_ns = now_ns.saturating_add(NOTE_EVERY_NS);
            shared.note_files(files);
        }
    }
}

/// Passes on a capture of another fleet as it comes, its times brought to this recording's clock.
fn pass_on(stream: impl Read, clock: Clock, shared: &Shared) -> Result<(), crate::ReadError> {
    let mut reader = Reader::new(stream)?;
    let theirs = reader.attachments().clock().unwrap_or(clock);
    let here = |unix_ns| clock.unix_ns(theirs.monotonic_ns(unix_ns));
    while let Some(entry) = reader.next_entry()? {
        shared.hand_on(Item {
            fleet: entry.fleet,
            times: Times {
                log_ns: here(entry.log_time_ns),
                publish_ns: here(entry.publish_time_ns),
            },
            message: entry.message,
        });
    }
    Ok(())
}
