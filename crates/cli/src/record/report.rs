//! Report of a recording.

use std::collections::BTreeMap;
use std::fmt;

use joulebus_capture_recorder::Summary;
use joulebus_plan::report::Lasting;
use rustix::time::{ClockId, clock_gettime};
use serde::Serialize;

#[derive(Debug, Serialize)]
pub(super) struct RecordReport {
    /// Duration of the recording, s.
    duration_s: f64,
    /// CPU time of the recorder per second of that duration: 1 is a whole core.
    cpu_share: f64,
    files: Vec<File>,
    messages: u64,
    bytes: u64,
    /// Messages by topic. Topics of single robots are omitted.
    topics: BTreeMap<String, u64>,
    /// Files that other processes have taken away: "removed", "replaced" or "cut".
    taken: BTreeMap<String, &'static str>,
    /// Reason that the ticks cannot be computed from the attachments, if so.
    differs: Option<String>,
    /// Messages lost by topic. Topics without losses are omitted.
    lost: BTreeMap<String, Lost>,
    messages_lost: u64,
    /// Memory buffer of a snapshot that was not written. None for other recordings.
    kept: Option<SnapshotReport>,
    /// Error that stopped the recording, if any.
    failure: Option<String>,
}

#[derive(Debug, Serialize)]
struct File {
    path: String,
    messages: u64,
    bytes: u64,
}

#[derive(Debug, Serialize)]
struct SnapshotReport {
    messages: u64,
    bytes: u64,
    /// Time span from the oldest to the newest, s.
    span_s: f64,
}

#[derive(Debug, Serialize)]
struct Lost {
    /// Overwritten in shared memory before the recorder read them.
    overwritten: u64,
    /// Not written because the disk was too slow, full, or failed.
    unwritten: u64,
}

impl RecordReport {
    pub(super) fn new(summary: &Summary, duration_s: f64) -> Self {
        let files = summary.files.iter().map(|(path, written)| File {
            path: path.display().to_string(),
            messages: written.messages,
            bytes: written.bytes,
        });
        let mut topics = BTreeMap::new();
        for (topic, count) in summary.files.iter().flat_map(|(_, file)| &file.by_topic) {
            if !topic.contains("/robot/") {
                *topics.entry(topic.clone()).or_default() += count;
            }
        }
        let lost = summary.lost.iter().map(|(topic, lost)| {
            let lost = Lost { overwritten: lost.overwritten, unwritten: lost.unwritten };
            (topic.clone(), lost)
        });
        Self {
            duration_s,
            cpu_share: cpu_s() / duration_s.max(1e-9),
            files: files.collect(),
            messages: summary.messages(),
            bytes: summary.bytes(),
            topics,
            taken: summary
                .taken
                .iter()
                .map(|(path, how)| (path.display().to_string(), *how))
                .collect(),
            differs: summary.differs.clone(),
            lost: lost.collect(),
            messages_lost: summary.messages_lost(),
            kept: summary.kept.map(|kept| SnapshotReport {
                messages: kept.messages,
                bytes: kept.bytes,
                span_s: kept.span_ns as f64 * 1e-9,
            }),
            failure: summary.failure.clone(),
        }
    }
}

/// CPU time of this process so far, s.
fn cpu_s() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

impl fmt::Display for RecordReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let per_hour = self.bytes as f64 * 1e-9 * 3_600.0 / self.duration_s.max(1e-9);
        writeln!(
            out,
            "recorded {}: {} messages, {:.3} MB ({per_hour:.2} GB an hour), {:.1} % of a core, \
             {} lost",
            Lasting(self.duration_s),
            self.messages,
            self.bytes as f64 * 1e-6,
            100.0 * self.cpu_share,
            self.messages_lost
        )?;
        for (topic, count) in &self.topics {
            writeln!(out, "  {topic}: {count}")?;
        }
        for (path, how) in &self.taken {
            writeln!(out, "  {path} was {how} by another process")?;
        }
        if let Some(differs) = &self.differs {
            writeln!(out, "  cannot be verified: {differs}")?;
        }
        for (topic, lost) in &self.lost {
            let (overwritten, unwritten) = (lost.overwritten, lost.unwritten);
            writeln!(
                out,
                "  LOST of {topic}: {overwritten} overwritten in shared memory, {unwritten} by the disk"
            )?;
        }
        for file in &self.files {
            let (path, messages, bytes) = (&file.path, file.messages, file.bytes);
            writeln!(out, "file {path}: {messages} messages, {bytes} bytes")?;
        }
        if let Some(SnapshotReport { messages, span_s, .. }) = &self.kept {
            let files = self.files.len();
            writeln!(
                out,
                "snapshot: {files} files were asked for. The last {span_s:.1} s in memory, \
                    {messages} messages, are in none of them"
            )?;
        }
        if let Some(failure) = &self.failure {
            writeln!(out, "stopped: {failure}")?;
        }
        Ok(())
    }
}
