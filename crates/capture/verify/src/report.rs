//! Result of a verification.

use std::collections::BTreeMap;
use std::fmt;

use joulebus_fleet::StateError;
use joulebus_wire::{Channel as _, State};
use serde::Serialize;

use crate::assemble::is_among_last;
use crate::compare::FieldDifference;
use crate::coverage::{Coverage, QUERIES, RunCoverage, Settled};
use crate::loss::Loss;
use crate::tick_id::TickId;
use joulebus_capture_format::MessageKind;

/// Maximum number of losses and refused keyframes listed.
const MAX_REPORTED: usize = 20;

/// Verdict of a verification.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// All that was sent was compared, and has the same bits. Excused are the two ends of a
    /// recording, and channels whose rules have changed since.
    Verified,
    /// All was recomputed, but whole channels that were sent are not recorded.
    NotCompared,
    /// Something was lost, or could not be recomputed.
    #[default]
    Incomplete,
    /// Recorded and computed values differ.
    Different,
}

/// Result of a verification.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Verification {
    /// The verdict.
    pub verdict: Verdict,
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
    /// Values that differ.
    pub differences: u64,
    /// Number of differences by field.
    pub differences_by_field: BTreeMap<String, u64>,
    /// The first difference.
    pub first: Option<Difference>,
    /// What was sent, recomputed and compared, by run and channel.
    pub coverage: Vec<RunCoverage>,
    /// Ticks before the first keyframe of a recording that began in the middle, where the worker's
    /// state is unknown.
    pub ticks_before_first_keyframe: u64,
    /// Incomplete last ticks of the recording, or of a worker.
    pub ticks_cut_off: u64,
    /// Ticks that could not be recomputed: an input was not recorded.
    pub ticks_unverified: u64,
    /// Ticks of which nothing was recorded, although ticks around them were.
    pub ticks_absent: u64,
    /// Output frames that were not recorded although their neighbours were, by kind.
    pub outputs_missing: BTreeMap<&'static str, u64>,
    /// Frames of which the capture has several that differ, and frames that belong to no tick.
    pub frames_ambiguous: u64,
    /// The first losses: tick and reason.
    pub losses: Vec<(u64, Loss)>,
    /// Kinds of outputs that were sent, and not recorded at all.
    pub not_recorded: Vec<&'static str>,
    /// Messages lost by the recorder, by gaps in their sequence numbers.
    pub messages_lost: u64,
    /// Questions recorded.
    pub queries: u64,
    /// Questions whose answer was computed again.
    pub queries_verified: u64,
    /// Questions refused for reasons of time (a deadline, a client that ended, a worker that
    /// ended), as far as the capture bears that out.
    pub queries_by_time: u64,
    /// Refusals for reasons of time that the capture does not prove: an answer may have been altered
    /// to one.
    pub refusals_unproven: u64,
    /// Acknowledgements of alarms among the questions: they have no answer to compute.
    pub acknowledgements: u64,
    /// Questions answered by the rules of another version.
    pub queries_of_other_rules: u64,
    /// Questions about ticks before the first keyframe, or cut off at the end.
    pub queries_outside: u64,
    /// Questions about a tick that could not be computed, or is not in the capture, and answers that
    /// cannot be.
    pub queries_unverified: u64,
    /// Complete keyframes found.
    pub keyframes: u64,
    /// Keyframes with a missing piece.
    pub broken_keyframes: u64,
    /// Keyframes that are missing: the next one names another one before it.
    pub missing_keyframes: u64,
    /// Keyframes refused: of another config, model or version.
    pub refused_keyframes: u64,
    /// Keyframes, and rules of answers, that deny the rules of ticks that the capture states.
    pub rules_denied: u64,
    /// The first refusals: tick and reason.
    pub refusals: Vec<(u64, String)>,
    /// Frames of samples that no recorded tick took.
    pub untaken_frames: u64,
    #[serde(skip)]
    counted: Coverage,
    /// The first tick of each run that was cut off, and how many of them were.
    #[serde(skip)]
    ends: BTreeMap<u64, (u64, u64)>,
    #[serde(skip)]
    times: Option<(u64, u64)>,
    #[serde(skip)]
    run: Option<u64>,
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

impl Verification {
    /// True if all that was sent was compared, without differences: [`Verdict::Verified`].
    pub fn is_clean(&self) -> bool {
        self.verdict == Verdict::Verified
    }

    fn judge(&self) -> Verdict {
        let is_complete = self.ticks_verified > 0
            && self.ticks_unverified == 0
            && self.ticks_absent == 0
            && self.queries_unverified == 0
            && self.refusals_unproven == 0
            && self.outputs_missing.is_empty()
            && self.frames_ambiguous == 0
            && self.messages_lost == 0
            && self.broken_keyframes == 0
            && self.missing_keyframes == 0
            && self.rules_denied == 0
            && self.refused_keyframes == 0;
        let mut channels = self.coverage.iter().flat_map(|run| &run.channels);
        let mut whole = channels.clone().filter(|(name, _)| self.not_recorded.contains(*name));
        if self.differences > 0 {
            Verdict::Different
        } else if !is_complete {
            Verdict::Incomplete
        } else if !self.not_recorded.is_empty() || whole.next().is_some() {
            Verdict::NotCompared
        } else if channels
            .any(|(name, channel)| *name != State::SERVICE.name() && !channel.missing.is_empty())
        {
            Verdict::Incomplete
        } else {
            Verdict::Verified
        }
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

    /// Counts a tick of which something was recorded, and those before it that are absent.
    pub(super) fn note_tick(&mut self, TickId { run: worker_epoch, .. }: TickId, absent: u64) {
        self.ticks += 1;
        self.ticks_absent = self.ticks_absent.saturating_add(absent);
        let run = self.counted.run(worker_epoch);
        run.ticks += 1;
        run.ticks_absent = run.ticks_absent.saturating_add(absent);
        if self.run.is_none_or(|run| worker_epoch > run) {
            self.runs += 1;
            self.run = Some(worker_epoch);
        }
    }

    pub(super) fn verified(&mut self, id: TickId, robots: usize) {
        self.ticks_verified += 1;
        self.robots = self.robots.max(robots);
        self.counted.recomputed(id);
    }

    /// Counts a frame that was sent.
    pub(super) fn settle(&mut self, id: TickId, kind: MessageKind, settled: &Settled) {
        self.counted.settle(id.run, kind.name(), settled);
        if let Settled::Recomputed(Loss::End) = settled {
            self.note_end(id, 0);
        }
    }

    /// Counts an answered question.
    pub(super) fn settle_query(&mut self, run: u64, settled: &Settled) {
        self.counted.settle(run, QUERIES, settled);
    }

    /// Counts a refusal for a reason of time, proven or not.
    pub(super) fn settle_refusal(&mut self, run: u64, why: Loss) {
        let count =
            if why.is_excused() { &mut self.queries_by_time } else { &mut self.refusals_unproven };
        *count += 1;
        self.settle_query(run, &Settled::Not(why));
    }

    /// Counts messages that are absent, by their numbers.
    pub(super) fn settle_absent(&mut self, run: u64, channel: &'static str, absent: u64) {
        self.counted.settle_absent(run, channel, absent);
    }

    /// Notes a tick that was cut off.
    fn note_end(&mut self, TickId { run, tick }: TickId, ticks: u64) {
        let (first, count) = self.ends.entry(run).or_insert((tick, 0));
        *first = tick.min(*first);
        *count += ticks;
    }

    /// Takes back the excuse of ticks that turn out not to be the last of their run, whose last
    /// tick is `last_tick`.
    pub(super) fn check_ends(&mut self, last_tick: impl Fn(u64) -> u64) {
        for (run, (first, count)) in std::mem::take(&mut self.ends) {
            if is_among_last(first, last_tick(run)) {
                continue;
            }
            self.ticks_cut_off -= count;
            self.ticks_unverified += count;
            self.note_loss(first, Loss::NotTheEnd);
            self.counted.refute_end(run);
        }
    }

    pub(super) fn differ(
        &mut self,
        TickId { run: worker_epoch, tick }: TickId,
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
    pub(super) fn lose(&mut self, id: TickId, why: Loss) {
        match why {
            Loss::End => {
                self.ticks_cut_off += 1;
                self.note_end(id, 1);
            }
            Loss::Before | Loss::Beginning => self.ticks_before_first_keyframe += 1,
            why => {
                self.ticks_unverified += 1;
                self.note_loss(id.tick, why);
            }
        }
    }

    /// Records a frame that contradicts others of its tick.
    pub(super) fn contradict(&mut self, tick: u64, why: Loss) {
        self.frames_ambiguous += 1;
        self.note_loss(tick, why);
    }

    /// Records that the capture states rules that what is in it denies.
    pub(super) fn deny_rules(&mut self, tick: u64, rules: u32) {
        self.rules_denied += 1;
        self.note_loss(tick, Loss::Rules(rules));
    }

    pub(super) fn lack_output(
        &mut self,
        kind: MessageKind,
        TickId { tick, .. }: TickId,
        why: Loss,
    ) {
        if why == Loss::End {
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

    pub(super) fn close(&mut self) {
        let (first, last) = self.times.unwrap_or_default();
        self.recorded_s = last.saturating_sub(first) as f64 / 1e9;
        self.coverage = std::mem::take(&mut self.counted).into_runs();
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
        self.verdict = self.judge();
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Verified => "verified",
            Self::NotCompared => "recomputed, not compared",
            Self::Incomplete => "incomplete",
            Self::Different => "different",
        })
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
            "{}: {} ticks, {} robots, {} differences",
            self.verdict, self.ticks_verified, self.robots, self.differences
        )?;
        let answers = self.queries - self.acknowledgements;
        if answers > 0 {
            let verified = self.queries_verified;
            writeln!(out, "{verified} of {answers} answers about plans computed again")?;
        }
        if self.acknowledgements > 0 {
            writeln!(out, "{} acknowledgements of alarms", self.acknowledgements)?;
        }
        for run in &self.coverage {
            write!(out, "{run}")?;
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
            (self.ticks_absent, "ticks are absent: the capture has nothing of them"),
            (
                self.frames_ambiguous,
                "frames contradict others: copies that differ, or frames of no tick",
            ),
            (
                self.queries_unverified,
                "answers about plans could not be verified: their ticks could not, are not in the \
                 capture, or the answers cannot be",
            ),
            (
                self.refusals_unproven,
                "refusals could not be compared: nothing in the capture proves that the worker ended, \
                 the client was gone, or as many questions waited as the reason says",
            ),
            (
                self.queries_of_other_rules,
                "answers about plans follow the rules of another version: only that version (build.json \
                 of the capture) computes them again",
            ),
            (self.queries_outside, "answers about plans are of ticks outside the verified ones"),
            (self.messages_lost, "messages were lost by the recorder"),
            (self.broken_keyframes, "keyframes are incomplete"),
            (
                self.missing_keyframes,
                "keyframes are missing: the next one names another before it, or none came in time",
            ),
            (self.refused_keyframes, "keyframes were refused"),
            (self.rules_denied, "keyframes or answers deny the rules that the capture states"),
            (self.untaken_frames, "frames of samples were taken by no recorded tick"),
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
            let channels = self.not_recorded.join(", ");
            writeln!(out, "not recorded, so not compared: {channels}")?;
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
