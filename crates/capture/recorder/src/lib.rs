#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod attachments;
mod capture_file;
mod channel;
mod drain;
mod files;
mod gaps;
mod item;
mod options;
mod queue;
pub mod replay;
mod shared;

use std::io::Read;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::JoinHandle;
use std::time::Duration;

use joulebus_bus::{Background, Steps, clock};
use joulebus_capture_format::{
    Attachments, Clock, MAX_CHANNELS, ReadError, Reader, Times, WriteError,
};
use joulebus_config::Config;

use drain::Drain;
use files::Files;
use item::Item;
use shared::Shared;

pub use attachments::{AttachError, attach, host_clock};
pub use channel::RecordedChannel;
pub use drain::DrainError;
pub use files::{SnapshotContents, Target};
pub use options::{Options, RECORDER, Snapshot, Suits};
pub use shared::{Lost, Summary};

/// Interval at which the writing thread looks for messages, and whether a chunk is due.
const WRITE_EVERY: Duration = Duration::from_millis(10);
/// Interval at which a running recording looks after its file and updates its summary, ns.
const NOTE_EVERY_NS: u64 = 500_000_000;

/// Errors of starting a recording.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
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
         channels, and a file can have {allowed}. Record fewer topics, or leave out --per-robot"
    )]
    TooManyChannels { fleet: String, robots: u64, needed: u64, allowed: u64 },
    /// A thread could not be started, or died at its start.
    #[error("the recorder cannot start: {0}")]
    Thread(#[from] std::io::Error),
}

/// A running recording.
#[derive(Debug)]
pub struct Recorder {
    shared: Arc<Shared>,
    drain: Option<Background>,
    streams: Vec<JoinHandle<()>>,
    writer: Option<Background>,
}

impl Recorder {
    /// Starts a recording: joins the fleet of `config`, opens the file, and records from now on.
    /// `streams` are captures of other fleets, written by other processes.
    ///
    /// # Errors
    /// [`StartError`]. No file is left behind.
    pub fn start(
        config: &Config,
        streams: Vec<Box<dyn Read + Send>>,
        clock: Clock,
        attachments: Attachments,
        target: Target,
        options: &Options,
    ) -> Result<Self, StartError> {
        check_channels(config, options)?;
        let shared = Arc::new(Shared::new(options));
        let mut recorder = Self { shared, drain: None, streams: Vec::new(), writer: None };
        recorder.start_drain(config, clock, options)?;
        for stream in streams {
            recorder.start_stream(stream, clock)?;
        }
        let (shared, options) = (Arc::clone(&recorder.shared), options.clone());
        // The last step that can fail creates the file, so a start that fails leaves none.
        recorder.writer = Some(Background::start("joulebus-write", move || {
            let files = Files::begin(target, attachments, options)?;
            Ok::<_, StartError>(FileWriter { files, shared, clock, note_from_ns: 0 })
        })?);
        Ok(recorder)
    }

    /// Saves the memory buffer, if this is a snapshot.
    pub fn write_down(&self) {
        self.shared.write_down.store(true, Ordering::Relaxed);
    }

    /// True if it has stopped because the file could not be written, or because a thread has ended.
    pub fn is_over(&self) -> bool {
        let mut threads = [&self.drain, &self.writer].into_iter().flatten();
        self.shared.over.load(Ordering::Relaxed) || threads.any(Background::has_ended)
    }

    /// The summary so far.
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
        self.drain = Some(Background::start("joulebus-drain", move || {
            let wanted = options.wanted(config.fleet());
            Ok::<_, StartError>(Drain::open(&config, clock, shared, wanted)?)
        })?);
        Ok(())
    }

    fn start_stream(
        &mut self,
        stream: Box<dyn Read + Send>,
        clock: Clock,
    ) -> Result<(), StartError> {
        let shared = Arc::clone(&self.shared);
        let builder = std::thread::Builder::new().name("joulebus-stream".to_owned());
        let stream = builder.spawn(move || {
            if let Err(error) = pass_on(stream, clock, &shared) {
                shared.note_failure(format!("another fleet's capture broke off: {error}"));
            }
        })?;
        self.streams.push(stream);
        Ok(())
    }

    fn stop(&mut self) {
        if let Some(Err(error)) = self.drain.as_mut().map(Background::finish) {
            // What was drained before is written.
            self.shared.note_failure(error.to_string());
        }
        for stream in self.streams.drain(..) {
            if stream.join().is_err() {
                self.shared.note_failure("a thread of the recorder panicked".to_owned());
            }
        }
        if let Some(Err(error)) = self.writer.as_mut().map(Background::finish) {
            self.shared.fail(error.to_string());
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
    let each = options.channels.iter().filter(|channel| channel.kind.has_robots());
    let needed = options.channels.len() as u64 + each.count() as u64 * robots;
    let allowed = MAX_CHANNELS as u64;
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

/// Writes what the queue contains, until stopped or until the file cannot be written.
struct FileWriter {
    files: Files,
    shared: Arc<Shared>,
    clock: Clock,
    note_from_ns: u64,
}

impl FileWriter {
    fn work(&mut self) -> Result<(), WriteError> {
        loop {
            let popped = self.shared.queue.pop();
            if self.shared.write_down.swap(false, Ordering::Relaxed) {
                self.files.write_down()?;
            }
            let is_empty = popped.is_none();
            if let Some(item) = popped {
                self.files.take(item)?;
            }
            let now_ns = clock::monotonic_ns();
            self.files.look(self.clock.unix_ns(now_ns))?;
            if now_ns >= self.note_from_ns {
                self.note_from_ns = now_ns.saturating_add(NOTE_EVERY_NS);
                self.files.check()?;
                self.shared.note_files(&self.files);
            }
            if is_empty {
                return Ok(());
            }
        }
    }

    fn end(&mut self, worked: Result<(), WriteError>) {
        let ended = self.files.end();
        if let Err(error) = worked.and(ended) {
            self.shared.fail(error.to_string());
            while let Some(item) = self.shared.queue.pop() {
                self.files.lose(&item);
            }
        }
        self.shared.end_files(&self.files);
    }
}

impl Steps for FileWriter {
    fn step(&mut self, last: bool) -> Option<Duration> {
        let worked = self.work();
        if last || worked.is_err() {
            self.end(worked);
            return None;
        }
        Some(WRITE_EVERY)
    }
}

/// Copies another fleet's capture from a stream, with its times converted to this recording's
/// clock.
fn pass_on(stream: impl Read, clock: Clock, shared: &Shared) -> Result<(), ReadError> {
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

#[cfg(test)]
mod tests {
    use super::*;

    struct Panics;

    impl Steps for Panics {
        fn step(&mut self, _: bool) -> Option<Duration> {
            panic!("a defect")
        }
    }

    #[test]
    fn a_recording_is_over_when_one_of_its_threads_has_ended_and_its_summary_states_it() {
        for is_drain in [true, false] {
            let thread = Background::start("joulebus-panics", || Ok::<_, StartError>(Panics));
            let (mut drain, mut writer) = (None, None);
            *(if is_drain { &mut drain } else { &mut writer }) = Some(thread.unwrap());
            let shared = Arc::new(Shared::new(&Options::default()));
            let recorder = Recorder { shared, drain, streams: Vec::new(), writer };
            while !recorder.is_over() {
                std::thread::sleep(WRITE_EVERY);
            }
            let failure = recorder.finish().failure.unwrap();
            assert!(failure.contains("joulebus-panics panicked"), "{failure}");
        }
    }
}
