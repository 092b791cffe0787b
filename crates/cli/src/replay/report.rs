//! What was played.

use std::collections::BTreeMap;
use std::fmt;

use serde::Serialize;

/// What a replay has played.
#[derive(Debug, Default, Serialize)]
pub(super) struct PlayReport {
    /// The files.
    pub(super) files: String,
    /// Name of the fleet in the capture.
    pub(super) fleet: String,
    /// Name that it was played under.
    pub(super) played_as: String,
    /// From the first message to the end, s.
    pub(super) duration_s: f64,
    /// Recorded time that was played, s.
    pub(super) played_s: f64,
    /// Passes through the capture, the last one perhaps not to its end.
    pub(super) passes: u64,
    /// Frames sent, by service.
    pub(super) frames: BTreeMap<&'static str, u64>,
    /// Samples sent.
    pub(super) samples: u64,
    /// Frames of the time before the offset, sent first so that planners know where they are.
    pub(super) frames_before: u64,
    /// Frames that could not be sent.
    pub(super) frames_failed: u64,
    /// Frames that a worker did not answer.
    pub(super) frames_unanswered: u64,
    /// Time by which the playback was held up, s.
    pub(super) held_up_s: f64,
    /// What could not be read.
    pub(super) damages: Vec<String>,
}

impl PlayReport {
    /// Whether something was not played that should have been.
    pub(super) fn has_lost(&self) -> bool {
        self.frames_failed > 0 || self.frames_unanswered > 0 || !self.damages.is_empty()
    }
}

impl fmt::Display for PlayReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let frames: Vec<String> = self
            .frames
            .iter()
            .map(|(service, count)| format!("{count} of {service}"))
            .collect();
        writeln!(
            out,
            "{} as fleet {}: frames: {}; {} samples, {:.1} s of recorded time in {:.1} s",
            self.files,
            self.played_as,
            if frames.is_empty() {
                "none".to_owned()
            } else {
                frames.join(", ")
            },
            self.samples,
            self.played_s,
            self.duration_s
        )?;
        for (count, what) in [
            (self.frames_failed, "frames could not be sent"),
            (
                self.frames_unanswered,
                "frames were not answered by the worker",
            ),
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
