//! How to record.

use std::fmt;
use std::sync::Arc;

use crate::{CaptureSettings, MessageKind};

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

/// What is kept in memory, and when it is saved.
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

impl Options {
    /// Whether a service of the fleet is needed for any topic that is recorded.
    pub(super) fn wants(&self, kind: MessageKind, fleet: &str) -> bool {
        let choose = &self.choose;
        let on_alarm = self.snapshot.is_some_and(|snapshot| snapshot.on_alarm);
        let alarms = on_alarm && kind == MessageKind::Diagnostics;
        // The journal tells which diagnostics were never sent.
        let diagnostics = kind == MessageKind::Ticks && self.wants(MessageKind::Diagnostics, fleet);
        choose(&kind.topic(fleet, 0)) || self.per_robot || alarms || diagnostics
    }
}
