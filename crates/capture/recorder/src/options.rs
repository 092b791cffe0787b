//! Options of a recording.

use std::fmt;
use std::sync::Arc;

use joulebus_capture_format::{CaptureSettings, MessageKind};
use joulebus_wire::{Diagnostics, PlanStateHeader, PlanStates, Ticks};

use crate::channel::RecordedChannel;

/// Name, among the members of a fleet, of processes that record it.
pub const RECORDER: &str = "recorder";

/// Checks that a worker runs with the settings and models that a capture has. Otherwise the reason.
pub type Suits = Arc<dyn Fn(&PlanStateHeader) -> Result<(), String> + Send + Sync>;

/// Options of a recording.
#[derive(Clone)]
pub struct Options {
    /// Settings of the files.
    pub settings: CaptureSettings,
    /// Also channels for single robots, for plots.
    pub per_robot: bool,
    /// Channels that can be recorded. Causes before effects. One that is declared elsewhere is
    /// added to [`RecordedChannel::all`].
    pub channels: Vec<RecordedChannel>,
    /// Chooses the topics that are recorded.
    pub choose: Arc<dyn Fn(&str) -> bool + Send + Sync>,
    /// Maximum file size, bytes. Then the next file begins.
    pub max_file_bytes: u64,
    /// Maximum duration of a file, ns. Then the next file begins. A file's index is kept in memory
    /// until its end: about 30 MB per hour.
    pub max_file_ns: u64,
    /// Maximum entries of a file's index, some 20 bytes each. Then the next file begins: with a
    /// channel for each of a thousand robots it would grow by gigabytes an hour.
    pub max_index_entries: u64,
    /// If the file exists, start the next part that does not, instead of an error.
    pub resume: bool,
    /// Keep the last seconds in memory instead of writing everything.
    pub snapshot: Option<Snapshot>,
    /// Size of the queue in front of the disk, bytes. Messages beyond it are dropped.
    pub queue_bytes: usize,
    /// Compares the joined fleet's worker with the attachments. Without it, a worker that began
    /// with other files than those on disk is not noticed.
    pub suits: Option<Suits>,
}

impl fmt::Debug for Options {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("Options")
            .field("settings", &self.settings)
            .field("per_robot", &self.per_robot)
            .field("channels", &self.channels)
            .field("max_file_bytes", &self.max_file_bytes)
            .field("max_file_ns", &self.max_file_ns)
            .field("max_index_entries", &self.max_index_entries)
            .field("resume", &self.resume)
            .field("snapshot", &self.snapshot)
            .field("queue_bytes", &self.queue_bytes)
            .finish_non_exhaustive()
    }
}

/// Configuration of a snapshot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Snapshot {
    /// Time span kept, ns.
    pub keep_ns: u64,
    /// Maximum size, bytes. The time span is reduced if necessary.
    pub max_bytes: usize,
    /// Save when a robot raises a new alarm, in addition to explicit requests.
    pub on_alarm: bool,
}

impl Default for Options {
    /// Everything in files of an hour, a queue of 128 MiB.
    fn default() -> Self {
        Self {
            settings: CaptureSettings::default(),
            per_robot: false,
            channels: RecordedChannel::all(),
            choose: Arc::new(|_| true),
            max_file_bytes: u64::MAX,
            max_file_ns: 3_600_000_000_000,
            max_index_entries: 8 << 20,
            resume: false,
            snapshot: None,
            queue_bytes: 128 << 20,
            suits: None,
        }
    }
}

impl Options {
    /// The channels that any recorded topic of the fleet needs.
    pub(super) fn wanted(&self, fleet: &str) -> impl Iterator<Item = RecordedChannel> {
        let channels = self.channels.iter().copied();
        channels.filter(move |channel| self.wants(channel.kind, fleet))
    }

    fn wants(&self, kind: MessageKind, fleet: &str) -> bool {
        let choose = &self.choose;
        let diagnostics = MessageKind::of::<Diagnostics>();
        let on_alarm = self.snapshot.is_some_and(|snapshot| snapshot.on_alarm);
        let alarms = on_alarm && kind == diagnostics;
        // The journal states which diagnostics were never sent.
        let unsent = kind == MessageKind::of::<Ticks>() && self.wants(diagnostics, fleet);
        // The starts of plans state what the worker runs with.
        let compared = self.suits.is_some() && kind == MessageKind::of::<PlanStates>();
        let compared = compared && choose(&MessageKind::of::<Ticks>().topic(fleet, 0));
        choose(&kind.topic(fleet, 0)) || self.per_robot || alarms || unsent || compared
    }
}
