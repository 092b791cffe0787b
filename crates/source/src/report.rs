//! The report of a source.

use std::collections::BTreeMap;
use std::fmt;

use joulebus_wire::DropReason;
use serde::Serialize;

/// Maximum number of notes shown as text.
const MAX_NOTES: usize = 5;

/// Report of a source.
#[derive(Debug, Default, Serialize)]
pub struct PublishReport {
    /// Name of the fleet.
    pub fleet: String,
    /// Name of the source.
    pub source: String,
    /// Robots of the source.
    pub robots: usize,
    /// Time from the first frame to the end, s.
    pub duration_s: f64,
    /// Frames sent.
    pub frames_sent: u64,
    /// Samples sent: the sum of those that the worker accepts and drops.
    pub samples_sent: u64,
    /// Frames sent while no worker was connected.
    pub frames_unheard: u64,
    /// Frames that could not be sent.
    pub frames_failed: u64,
    /// Frames that a worker did not answer.
    pub frames_unanswered: u64,
    /// Samples that the worker refused, by reason, as it told at most two seconds before the end.
    pub samples_refused: BTreeMap<&'static str, u64>,
    /// Grid times skipped because the source stalled.
    pub ticks_skipped: u64,
    /// Time by which the playback was delayed, s.
    pub held_up_s: f64,
    /// Recorded time over playback time. `None` for a simulation.
    pub speed: Option<f64>,
    /// The recordings.
    pub trials: Vec<PlayedTrial>,
}

/// One recording.
#[derive(Debug, Serialize)]
pub struct PlayedTrial {
    /// Id of its robot.
    pub robot: u32,
    /// The file.
    pub file: String,
    /// Its samples sent.
    pub samples: u64,
    /// Notes on it.
    pub notes: String,
    /// True if there are no notes on faults.
    pub clean: bool,
}

impl PublishReport {
    /// True if samples did not reach a worker that should have, or if it refused some for what they
    /// say. Not for what others do: another source or a successor has the robot, or the worker is
    /// behind, as a live source must expect.
    pub fn has_lost(&self) -> bool {
        use DropReason::{Backlog, BeforeJoin, ForeignSource, OldEpoch, Overflow};
        let by_others = [ForeignSource, OldEpoch, Backlog, Overflow, BeforeJoin];
        let mut reasons = self.samples_refused.keys();
        let is_refused =
            reasons.any(|reason| !by_others.iter().any(|other| other.name() == *reason));
        self.frames_failed > 0 || self.frames_unanswered > 0 || is_refused
    }
}

impl fmt::Display for PublishReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { fleet, source, robots, duration_s, frames_sent, samples_sent, .. } = self;
        writeln!(
            out,
            "{source} to fleet {fleet}: {samples_sent} samples of {robots} robots in {frames_sent} \
             frames, {duration_s:.1} s"
        )?;
        for (count, what) in [
            (self.frames_unheard, "frames sent while no worker was connected"),
            (self.frames_failed, "frames could not be sent"),
            (self.frames_unanswered, "frames were not answered by the worker"),
            (self.ticks_skipped, "ticks skipped: the source was stalled"),
        ] {
            if count > 0 {
                writeln!(out, "{count} {what}")?;
            }
        }
        for (reason, count) in &self.samples_refused {
            writeln!(out, "{count} samples refused by the worker: {reason}")?;
        }
        if let Some(speed) = self.speed {
            writeln!(out, "played at {speed:.2} times the recorded speed")?;
        }
        if self.held_up_s > 0.0 {
            writeln!(out, "delayed by {:.1} s", self.held_up_s)?;
        }
        let questionable = self.trials.iter().filter(|trial| !trial.clean);
        let more = questionable.clone().count().saturating_sub(MAX_NOTES);
        for trial in questionable.take(MAX_NOTES) {
            writeln!(out, "robot {}: {}: {}", trial.robot, trial.file, trial.notes)?;
        }
        if more > 0 {
            writeln!(out, "{more} more recordings have gaps or other oddities: see --format json")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_refused_for_what_they_say_are_lost() {
        use DropReason::{Backlog, BadTime, ForeignSource, OldEpoch};
        let others = [ForeignSource, OldEpoch, Backlog].map(|reason| (reason, false));
        for (reason, lost) in others.into_iter().chain([(BadTime, true)]) {
            let samples_refused = BTreeMap::from([(reason.name(), 7)]);
            let report = PublishReport { samples_refused, ..PublishReport::default() };
            assert_eq!(report.has_lost(), lost, "{report}");
        }
    }
}
