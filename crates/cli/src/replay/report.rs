//! Report of a replay.

use std::collections::BTreeMap;
use std::fmt;

use serde::Serialize;

#[derive(Debug, Default, Serialize)]
pub(super) struct PlayReport {
    pub(super) files: String,
    /// Name of the fleet in the capture.
    pub(super) fleet: String,
    /// Name under which it was played.
    pub(super) played_as: String,
    /// Wall-clock time from the first message to the end, s.
    pub(super) duration_s: f64,
    /// Recorded time that was played, s.
    pub(super) played_s: f64,
    /// Passes through the capture, including an incomplete last one.
    pub(super) passes: u64,
    /// Frames sent, by service.
    pub(super) frames: BTreeMap<&'static str, u64>,
    pub(super) samples: u64,
    /// Frames from before the offset, sent first as the initial state for planners.
    pub(super) frames_before: u64,
    /// Frames that could not be sent.
    pub(super) frames_failed: u64,
    /// Frames without an answer from a worker.
    pub(super) frames_unanswered: u64,
    /// Total time of hold-ups, s.
    pub(super) held_up_s: f64,
    pub(super) damages: Vec<String>,
}

impl PlayReport {
    /// True if something was not played that should have been.
    pub(super) fn has_lost(&self) -> bool {
        self.frames_failed > 0 || self.frames_unanswered > 0 || !self.damages.is_empty()
    }
}

impl fmt::Display for PlayReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let frames: Vec<String> =
            self.frames.iter().map(|(service, count)| format!("{count} of {service}")).collect();
        writeln!(
            out,
            "{} as fleet {}: frames: {}; {} samples, {:.1} s of recorded time in {:.1} s",
            self.files,
            self.played_as,
            if frames.is_empty() { "none".to_owned() } else { frames.join(", ") },
            self.samples,
            self.played_s,
            self.duration_s
        )?;
        for (count, what) in [
            (self.frames_failed, "frames could not be sent"),
            (self.frames_unanswered, "frames were not answered by a worker"),
        ] {
            if count > 0 {
                writeln!(out, "{count} {what}")?;
            }
        }
        if self.held_up_s > 0.0 {
            writeln!(out, "held up for {:.1} s", self.held_up_s)?;
        }
        for damage in &self.damages {
            writeln!(out, "{damage}")?;
        }
        Ok(())
    }
}
