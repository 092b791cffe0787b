//! Records fleets: one thread drains shared memory into a bounded queue, another encodes,
//! compresses and writes.
//!
//! A slow disk fills the queue; when it is full, messages are dropped and counted, without effect
//! on the worker and its planners. A full disk ends the capture with an error, and the written part
//! can be recovered.
//!
//! A process can join only one fleet's shared memory. Other fleets are read from streams: captures
//! written to a pipe by separate processes.

mod drain;
mod files;
mod gaps;
mod item;
mod options;
mod queue;
mod shared;

use std::io::Read;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::sync_channel;
use std::thread::JoinHandle;
use std::time::Duration;

use joulebus_bus::clock;
use joulebus_config::Config;

use crate::{Attachments, Clock, MessageKind, Reader, Times, WriteError};
use drain::Drain;
use files::Files;
use item::Item;
use queue::Popped;
use shared::Shared;

pub use drain::DrainError;
pub use files::{Kept, Target};
pub use options::{Options, Snapshot};
pub use shared::{Lost, Summary};

/// Interval at which the writing thread checks whether a chunk is due.
const PATIENCE: Duration = Duration::from_millis(10);
/// Interval at which a running recording updates its summary, ns.
const NOTE_EVERY_NS: u64 = 500_000_000;

/// Errors of starting a recording.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StartError {
    /// The fleet's services could not be opened.
    #[error(transparent)]
    Drain(#[from] DrainError),
    /// The file could not be created.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// More channels than a file can have.
    #[error(
        "channels for single robots: fleet {fleet} has a capacity of {robots} robots, that is {needed} \
         channels, and a file can have {allowed}; record fewer topics, or without them"
    )]
    TooManyChannels {
        /// The fleet.
        fleet: String,
        /// Robots that it has capacity for.
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

/// A running recording.
#[derive(Debug)]
pub struct Recorder {
    shared: Arc<Shared>,
    feeds: Vec<JoinHandle<()>>,
    writer: Option<JoinHandle<()>>,
}

impl Recorder {
    /// Starts a recording: joins the fleet of `config`, opens the file, and records from now on.
    /// `streams` are captures of other fleets, written by other processes.
    ///
    /// # Errors
    /// [`StartError`]; at most an empty file is left behind.
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
        let shared = Arc::new(Shared::new(options));
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

    /// Saves the memory buffer, if this is a snapshot.
    pub fn write_down(&self) {
        self.shared.write_down.store(true, Ordering::Relaxed);
    }

    /// Whether it has stopped because the file could not be written.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.shared.over.load(Ordering::Relaxed)
    }

    /// The summary so far.
    #[must_use]
    pub fn summary(&self) -> Summary {
        self.shared.summary()
    }

    /// Drains shared memory, finishes the file and returns the summary.
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
                    // The caller waits for the message.
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

/// The number of channels per file is limited: checked before recording channels of all robots.
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

/// The writing thread: until the queue is closed and empty, or the file cannot be written.
fn write(mut files: Files, shared: &Shared, clock: Clock) {
    let worked = work(&mut files, shared, clock);
    let ended = files.end();
    if let Err(error) = worked.and(ended) {
        shared.fail(error.to_string());
        while let Popped::Item(item) = shared.queue.pop(Duration::ZERO) {
            files.lose(&item);
        }
    }
    shared.end_files(&files);
}

fn work(files: &mut Files, shared: &Shared, clock: Clock) -> Result<(), WriteError> {
    let mut note_from_ns = 0;
    loop {
        let popped = shared.queue.pop(PATIENCE);
        if shared.write_down.swap(false, Ordering::Relaxed) {
            files.write_down()?;
        }
        match popped {
            Popped::Item(item) => files.take(item)?,
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

/// Copies another fleet's capture from a stream, with its times converted to this recording's
/// clock.
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
