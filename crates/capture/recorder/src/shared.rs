//! State shared by the threads of a recording: the queue, losses, and the summary.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use joulebus_bus::clock;

use crate::files::{Files, SnapshotContents};
use crate::gaps::Gaps;
use crate::item::Item;
use crate::options::Options;
use crate::queue::Queue;
use joulebus_capture_format::{Message, MessageKind, Written};
use joulebus_wire::{PlanStates, Samples};

/// Losses of a topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Lost {
    /// Messages overwritten in shared memory before the recorder received them.
    pub overwritten: u64,
    /// Messages dropped because the queue was full, or not written: the disk was too slow, full or
    /// failed.
    pub unwritten: u64,
}

/// Results of a recording.
#[derive(Debug, Clone, Default)]
pub struct Summary {
    /// Files with their statistics.
    pub files: Vec<(PathBuf, Written)>,
    /// Files that other processes have removed, replaced or cut while they were recorded, and which
    /// of it: their messages are among the lost.
    pub taken: Vec<(PathBuf, &'static str)>,
    /// Reason that recorded ticks cannot be computed from the attachments: the worker runs with
    /// others.
    pub differs: Option<String>,
    /// Losses by topic. Topics without losses are omitted.
    pub lost: BTreeMap<String, Lost>,
    /// Memory buffer of a snapshot that was not written. None for other recordings.
    pub kept: Option<SnapshotContents>,
    /// Reason that the recorder stopped before its end, if it did.
    pub failure: Option<String>,
}

impl Summary {
    /// Messages in all files.
    pub fn messages(&self) -> u64 {
        self.files.iter().map(|(_, written)| written.messages).sum()
    }

    /// Bytes of all files.
    pub fn bytes(&self) -> u64 {
        self.files.iter().map(|(_, written)| written.bytes).sum()
    }

    /// Messages lost.
    pub fn messages_lost(&self) -> u64 {
        let lost = self.lost.values();
        // False frames state any numbers.
        lost.map(|lost| lost.overwritten.saturating_add(lost.unwritten))
            .fold(0, u64::saturating_add)
    }
}

/// State shared by the threads.
#[derive(Debug)]
pub(crate) struct Shared {
    pub(super) write_down: AtomicBool,
    pub(super) over: AtomicBool,
    pub(super) queue: Queue,
    gaps: Mutex<(Gaps, BTreeMap<String, Lost>)>,
    summary: Mutex<Summary>,
    options: Options,
}

impl Shared {
    pub(super) fn new(options: &Options) -> Self {
        Self {
            write_down: AtomicBool::new(false),
            over: AtomicBool::new(false),
            queue: Queue::new(options.queue_bytes),
            gaps: Mutex::new((Gaps::new(clock::monotonic_ns()), BTreeMap::new())),
            summary: Mutex::default(),
            options: options.clone(),
        }
    }

    /// The ports of the fleet are open since then, monotonic ns.
    pub(crate) fn opened(&self, fleet: Arc<str>, opened_ns: u64) {
        self.gaps.lock().unwrap_or_else(PoisonError::into_inner).0.opened(fleet, opened_ns);
    }

    /// Compares the worker of the joined fleet with the attachments.
    pub(crate) fn compare(&self, message: &Message) {
        let Some(suits) = &self.options.suits else { return };
        let Some(frame) = message.frame::<PlanStates>() else { return };
        let Err(reason) = suits(&frame.header) else { return };
        let mut summary = self.summary.lock().unwrap_or_else(PoisonError::into_inner);
        if summary.differs.is_none() {
            tracing::warn!(%reason, "this capture cannot be verified");
            summary.differs = Some(reason);
        }
    }

    /// Puts the item into the queue, unless the recording begins after it. Counts the messages
    /// missing before it, and itself if it is dropped.
    pub(crate) fn hand_on(&self, item: Item) {
        let found = {
            let mut gaps = self.gaps.lock().unwrap_or_else(PoisonError::into_inner);
            gaps.0.look(&item.fleet, &item.message)
        };
        let (fleet, topic) = (Arc::clone(&item.fleet), item.topic());
        let unwritten = (!found.is_before && !self.queue.push(item)).into();
        self.count(topic, found.missing, unwritten);
        if found.samples > 0 {
            self.count(MessageKind::of::<Samples>().topic(&fleet, 0), found.samples, 0);
        }
        for kind in found.never_sent {
            self.forgive(&kind.topic(&fleet, 0));
        }
    }

    fn forgive(&self, topic: &str) {
        let mut gaps = self.gaps.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(lost) = gaps.1.get_mut(topic) {
            lost.overwritten = lost.overwritten.saturating_sub(1);
            if *lost == Lost::default() {
                gaps.1.remove(topic);
            }
        }
    }

    pub(super) fn count(&self, topic: String, overwritten: u64, unwritten: u64) {
        if overwritten > 0 || unwritten > 0 {
            let mut gaps = self.gaps.lock().unwrap_or_else(PoisonError::into_inner);
            let lost = gaps.1.entry(topic).or_default();
            lost.overwritten = lost.overwritten.saturating_add(overwritten);
            lost.unwritten = lost.unwritten.saturating_add(unwritten);
        }
    }

    pub(super) fn summary(&self) -> Summary {
        let summary = self.summary.lock().unwrap_or_else(PoisonError::into_inner);
        let gaps = self.gaps.lock().unwrap_or_else(PoisonError::into_inner);
        // The journal is also read for the diagnostics: messages of kinds that are not recorded are
        // not lost.
        let is_asked_for = |topic: &str| self.options.per_robot || (self.options.choose)(topic);
        let lost = gaps.1.iter().filter(|(topic, _)| is_asked_for(topic));
        Summary {
            lost: lost.map(|(topic, lost)| (topic.clone(), *lost)).collect(),
            ..summary.clone()
        }
    }

    pub(super) fn note_files(&self, files: &Files) {
        let mut summary = self.summary.lock().unwrap_or_else(PoisonError::into_inner);
        summary.files = files.written();
        summary.taken = files.taken().to_vec();
        summary.kept = files.kept();
    }

    /// Final statistics of the files.
    pub(super) fn end_files(&self, files: &Files) {
        for (topic, count) in files.lost() {
            self.count(topic.clone(), 0, *count);
        }
        self.note_files(files);
    }

    pub(super) fn note_failure(&self, reason: String) {
        let mut summary = self.summary.lock().unwrap_or_else(PoisonError::into_inner);
        summary.failure.get_or_insert(reason);
    }

    /// Stops writing: all further messages are counted as lost.
    pub(super) fn fail(&self, reason: String) {
        self.note_failure(reason);
        self.over.store(true, Ordering::Relaxed);
        self.queue.close();
    }
}
