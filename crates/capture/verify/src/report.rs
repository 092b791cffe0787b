//! Result of a verification.

use std::collections::BTreeMap;
use std::fmt;

use joulebus_fleet::StateError;
use serde::Serialize;

use crate::compare::FieldDifference;
use joulebus_capture_format::MessageKind;

/// Maximum number of losses and refused keyframes listed.
const MAX_REPORTED: usize = 20;

/// Result of a verification.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Verification {
    /// Messages read.
    pub messages: u64,
    /// Time from the first to the last of them, s.
    pub recorded_s: f64,
    /// Runs of the worker in the capture.
    pub runs: u64,
    /// Ticks with any recorded part.
    pub ticks: u64,
    /// Ticks recomputed.
    pub ticks_verified: u64,
    /// Maximum number of robots in a tick.
    pub robots: usize,
    /// Forecasts compared. The other outputs are not counted.
    pub forecasts_compared: u64,
    /// Values that differ.
    pub differences: u64,
    /// Number of differences by field.
    pub differences_by_field: BTreeMap<String, u64>,
    /// The first difference.
    pub first: Option<Difference>,
    /// Ticks before the first keyframe of a recording that began in the middle, where the worker's
    /// state is unknown.
    pub ticks_before_first_keyframe: u64,
    /// Incomplete last ticks of the recording, or of a worker.
    pub ticks_cut_off: u64,
    /// Ticks that could not be recomputed: an input was not recorded.
    pub ticks_unverified: u64,
    /// Output frames that were not recorded although their neighbours were, by kind.
    pub outputs_missing: BTreeMap<&'static str, u64>,
    /// The first losses: tick and reason.
    pub losses: Vec<(u64, Loss)>,
    /// Kinds of outputs that were not recorded at all.
    pub not_recorded: Vec<&'static str>,
    /// Messages lost by the recorder, by gaps in their sequence numbers.
    pub messages_lost: u64,
    /// Questions recorded.
    pub queries: u64,
    /// Questions whose answer was computed again.
    pub queries_verified: u64,
    /// Questions refused for reasons of time (a deadline, a client that ended, a worker that
    /// ended), and acknowledgements.
    pub queries_by_time: u64,
    /// Questions answered by the rules of another version.
    pub queries_of_other_rules: u64,
    /// Questions about ticks before the first or after the last that was computed.
    pub queries_outside: u64,
    /// Questions about a tick that could not be computed.
    pub queries_unverified: u64,
    /// Keyframes found.
    pub keyframes: u64,
    /// Keyframes with a missing piece.
    pub broken_keyframes: u64,
    /// Keyframes refused: of another config, model or version.
    pub refused_keyframes: u64,
    /// The first refusals: tick and reason.
    pub refusals: Vec<(u64, String)>,
    /// Frames of samples that no recorded tick took.
    pub untaken_frames: u64,
    #[serde(skip)]
    times: Option<(u64, u64)>,
    #[serde(skip)]
    run: Option<u64>,
    /// True if the verification has begun.
    #[serde(skip)]
    pub(super) has_begun: bool,
    /// A worker's outputs, and whether they are recorded.
    #[serde(skip)]
    outputs: Vec<(MessageKind, bool)>,
}

/// One value that differs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Difference {
    /// The worker's run, as in [`joulebus_wire::ForecastHeader::worker_epoch`].
    pub worker_epoch: u64,
    /// The tick in it.
    pub tick: u64,
    /// The robot, if it concerns one.
    pub robot: Option<u32>,
    /// Payload and field.
    pub field: String,
    /// The recorded value.
    pub recorded: String,
    /// The computed value.
    pub computed: String,
}

/// Reason that a tick could not be recomputed or compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum Loss {
    /// Its journal was not recorded.
    Journal,
    /// A frame of samples that it took was not recorded.
    Samples {
        /// Its source.
        source_id: u64,
        /// Its number.
        frame_seq: u64,
    },
    /// The tick took a frame of which the capture has several that differ, or one of another
    /// length. A process sends in the source's name, and nothing shows which frame the worker took.
    Ambiguous {
        /// Its source.
        source_id: u64,
        /// Its number.
        frame_seq: u64,
    },
    /// The tick took more frames than a journal lists.
    Unlisted,
    /// One of its outputs was not recorded.
    Output,
    /// No keyframe was recorded between the last loss and it.
    NoKeyframe,
    /// The tick took a frame that was sent before the recording began.
    Beginning,
    /// The recording, or the worker, ended with it.
    End,
}

impl Verification {
    /// True if everything was verified without differences. Ticks before the first keyframe of a
    /// recording, and an incomplete tick at its end, are not losses.
    #[must_use]
    pub fn is_clean(&self) -> bool {
        self.differences == 0
            && self.ticks_verified > 0
            && self.ticks_unverified == 0
            && self.queries_unverified == 0
            && self.outputs_missing.is_empty()
            && self.messages_lost == 0
    }

    pub(super) fn note_time(&mut self, log_time_ns: u64) {
        let (first, last) = self.times.unwrap_or((log_time_ns, log_time_ns));
        self.times = Some((first.min(log_time_ns), last.max(log_time_ns)));
    }

    pub(super) fn note_kind(&mut self, kind: MessageKind) {
        let mut outputs = self.outputs.iter_mut();
        if let Some((_, seen)) = outputs.find(|(output, _)| *output == kind) {
            *seen = true;
        }
    }

    /// Frames of this kind are expected.
    pub(super) fn expect(&mut self, kind: MessageKind) {
        self.outputs.push((kind, false));
    }

    pub(super) fn note_tick(&mut self, (worker_epoch, _): (u64, u64)) {
        self.ticks += 1;
        if self.run.is_none_or(|run| worker_epoch > run) {
            self.runs += 1;
            self.run = Some(worker_epoch);
        }
    }

    pub(super) fn verified(&mut self, robots: usize) {
        self.ticks_verified += 1;
        self.has_begun = true;
        self.robots = self.robots.max(robots);
        self.forecasts_compared += robots as u64;
    }

    pub(super) fn differ(
        &mut self,
        (worker_epoch, tick): (u64, u64),
        what: &str,
        robot: Option<u32>,
        (field, recorded, computed): FieldDifference,
    ) {
        self.differences += 1;
        let field = format!("{what}.{field}");
        if self.first.is_none() {
            self.first = Some(Difference {
                worker_epoch,
                tick,
                robot,
                field: field.clone(),
                recorded: recorded.to_string(),
                computed: computed.to_string(),
            });
        }
        *self.differences_by_field.entry(field).or_default() += 1;
    }

    /// Records a tick that is not computed.
    pub(super) fn lose(&mut self, (_, tick): (u64, u64), why: Loss) {
        match why {
            Loss::End => self.ticks_cut_off += 1,
            Loss::Beginning => {
                self.has_begun = false;
                self.ticks_before_first_keyframe += 1;
            }
            Loss::NoKeyframe if !self.has_begun => self.ticks_before_first_keyframe += 1,
            why => {
                self.ticks_unverified += 1;
                self.note_loss(tick, why);
            }
        }
    }

    pub(super) fn lack_output(&mut self, kind: MessageKind, (_, tick): (u64, u64), why: Loss) {
        if why == Loss::End {
            self.ticks_cut_off += 1;
            return;
        }
        *self.outputs_missing.entry(kind.name()).or_default() += 1;
        self.note_loss(tick, why);
    }

    pub(super) fn refuse_keyframe(&mut self, tick: u64, error: &StateError) {
        self.refused_keyframes += 1;
        if self.refusals.len() < MAX_REPORTED {
            self.refusals.push((tick, error.to_string()));
        }
    }

    fn note_loss(&mut self, tick: u64, why: Loss) {
        if self.losses.len() < MAX_REPORTED {
            self.losses.push((tick, why));
        }
    }

    /// Completes the counts.
    pub(super) fn close(&mut self) {
        let (first, last) = self.times.unwrap_or_default();
        self.recorded_s = last.saturating_sub(first) as f64 / 1e9;
        for (kind, seen) in std::mem::take(&mut self.outputs) {
            if !seen {
                let missing = self.outputs_missing.remove(kind.name());
                // Some are sent only while somebody reads them.
                if !kind.flow().is_on_demand() || missing.is_some() {
                    self.not_recorded.push(kind.name());
                }
            }
        }
        // Without any keyframe, nothing was verified: that is a loss.
        if self.ticks_verified == 0 {
            self.ticks_unverified += std::mem::take(&mut self.ticks_before_first_keyframe);
        }
    }
}

impl fmt::Display for Loss {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Journal => write!(out, "its journal was not recorded"),
            Self::Samples { source_id, frame_seq } => {
                write!(out, "frame {frame_seq} of source {source_id:016x} was not recorded")
            }
            Self::Ambiguous { source_id, frame_seq } => write!(
                out,
                "other frames claim to be frame {frame_seq} of source {source_id:016x}: another process sends in its name"
            ),
            Self::Unlisted => write!(out, "it took more frames than a journal lists"),
            Self::Output => write!(out, "its output was not recorded"),
            Self::NoKeyframe => write!(out, "no keyframe before it"),
            Self::Beginning => write!(out, "it took frames sent before the recording began"),
            Self::End => write!(out, "the recording ends there"),
        }
    }
}

impl fmt::Display for Difference {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "tick {}", self.tick)?;
        if let Some(robot) = self.robot {
            write!(out, ", robot {robot}")?;
        }
        write!(out, ", {}: recorded {}, computed {}", self.field, self.recorded, self.computed)
    }
}

impl fmt::Display for Verification {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            out,
            "{} ticks, {} robots, {} differences",
            self.ticks_verified, self.robots, self.differences
        )?;
        if self.queries > 0 {
            let (verified, all) = (self.queries_verified, self.queries);
            writeln!(out, "{verified} of {all} answers about plans computed again")?;
        }
        if let Some(first) = &self.first {
            writeln!(out, "first: {first}")?;
            for (field, count) in &self.differences_by_field {
                writeln!(out, "  {count} in {field}")?;
            }
        }
        let unverified = self.ticks_unverified;
        for (count, what) in [
            (unverified, "ticks could not be verified"),
            (
                self.queries_unverified,
                "answers about plans could not be verified: their ticks could not",
            ),
            (
                self.queries_of_other_rules,
                "answers about plans follow the rules of another version: only that version (build.json \
                 of the capture) computes them again",
            ),
            (self.queries_outside, "answers about plans are of ticks outside the verified ones"),
            (self.messages_lost, "messages were lost by the recorder"),
            (self.broken_keyframes, "keyframes are incomplete"),
            (self.refused_keyframes, "keyframes were refused"),
            (
                self.ticks_before_first_keyframe,
                "ticks lie before the first keyframe: not verified, the recording began in the middle",
            ),
            (
                self.ticks_cut_off,
                "ticks are incomplete at the end of the recording or of the worker",
            ),
        ] {
            if count > 0 {
                writeln!(out, "{count} {what}")?;
            }
        }
        for (kind, count) in &self.outputs_missing {
            writeln!(out, "{count} frames of {kind} were not recorded")?;
        }
        for (tick, why) in &self.losses {
            writeln!(out, "  tick {tick}: {why}")?;
        }
        for (tick, why) in &self.refusals {
            writeln!(out, "  keyframe after tick {tick}: {why}")?;
        }
        if !self.not_recorded.is_empty() {
            writeln!(out, "not recorded: {}", self.not_recorded.join(", "))?;
        }
        if self.keyframes == 0 {
            writeln!(
                out,
                "there is no keyframe: record the topics `state`, `ticks` and `samples` too"
            )?;
        }
        Ok(())
    }
}
