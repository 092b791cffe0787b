//! Coverage: what was sent, recomputed and compared, by run of the worker and channel.

use std::collections::BTreeMap;
use std::fmt;

use joulebus_wire::{Channel as _, State};
use serde::Serialize;

use crate::loss::Loss;
use crate::tick_id::TickId;

/// Name of the channel of questions.
pub(super) const QUERIES: &str = "queries";
/// Maximum number of runs listed. Further ones are added up in the last.
const MAX_RUNS: usize = 1_000;
/// Maximum number of ranges of ticks listed in a run.
const MAX_RANGES: usize = 1_000;

/// Coverage of one run of the worker.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct RunCoverage {
    /// The run, as in [`joulebus_wire::ForecastHeader::worker_epoch`].
    pub worker_epoch: u64,
    /// Ticks with any recorded part.
    pub ticks: u64,
    /// Ticks without any, between the recorded ones, or before the first of a run that began during
    /// the recording. The worker numbers its ticks from 1, without gaps.
    pub ticks_absent: u64,
    /// First and last tick of each range that was recomputed.
    pub recomputed: Vec<(u64, u64)>,
    /// Ranges beyond those listed.
    pub ranges_omitted: u64,
    /// Frames by channel. Those of `state` are keyframes.
    pub channels: BTreeMap<&'static str, ChannelCoverage>,
}

/// Coverage of a channel in a run: `sent` is the sum of `compared`, `excused` and `missing`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct ChannelCoverage {
    /// Frames sent, by the journals. Where a journal is missing, and for keyframes: frames found.
    pub sent: u64,
    /// Frames that were computed again.
    pub recomputed: u64,
    /// Frames compared with the recorded ones.
    pub compared: u64,
    /// Frames that no recording of this kind allows to compare, by reason.
    pub excused: BTreeMap<String, u64>,
    /// Frames that were not compared for another reason.
    pub missing: BTreeMap<String, u64>,
}

/// How the comparison of a frame ended.
#[derive(Debug, Clone)]
pub(super) enum Settled {
    /// Its bits were compared.
    Compared,
    /// It could not be compared.
    Not(Loss),
    /// As [`Settled::Not`], although it was computed again.
    Recomputed(Loss),
}

impl ChannelCoverage {
    fn add(&mut self, other: Self) {
        self.sent = self.sent.saturating_add(other.sent);
        self.recomputed += other.recomputed;
        self.compared += other.compared;
        for (reasons, others) in
            [(&mut self.excused, other.excused), (&mut self.missing, other.missing)]
        {
            for (reason, count) in others {
                let sum = reasons.entry(reason).or_default();
                *sum = sum.saturating_add(count);
            }
        }
    }

    pub(super) fn settle(&mut self, settled: &Settled) {
        // Numbers in a capture may be any, and so the count of absent ones.
        self.sent = self.sent.saturating_add(1);
        let lack = match settled {
            Settled::Compared => {
                self.recomputed += 1;
                self.compared += 1;
                return;
            }
            Settled::Recomputed(lack) => {
                self.recomputed += 1;
                lack
            }
            Settled::Not(lack) => lack,
        };
        let reasons = if lack.is_excused() { &mut self.excused } else { &mut self.missing };
        let count = reasons.entry(lack.reason()).or_default();
        *count = count.saturating_add(1);
    }
}

/// Coverage of all runs.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Coverage {
    runs: BTreeMap<u64, RunCoverage>,
}

impl Coverage {
    pub(super) fn run(&mut self, worker_epoch: u64) -> &mut RunCoverage {
        let is_listed = self.runs.len() < MAX_RUNS || self.runs.contains_key(&worker_epoch);
        let listed = if is_listed { worker_epoch } else { u64::MAX };
        let run = self.runs.entry(listed).or_default();
        run.worker_epoch = listed;
        run
    }

    pub(super) fn settle(&mut self, run: u64, channel: &'static str, settled: &Settled) {
        self.run(run).channels.entry(channel).or_default().settle(settled);
    }

    /// Messages whose numbers are left out.
    pub(super) fn settle_absent(&mut self, run: u64, channel: &'static str, absent: u64) {
        if absent > 0 {
            let channel = self.run(run).channels.entry(channel).or_default();
            channel.sent = channel.sent.saturating_add(absent);
            let reason = "absent: their numbers have a gap".to_owned();
            let count = channel.missing.entry(reason).or_default();
            *count = count.saturating_add(absent);
        }
    }

    /// Frames at what is not the end of the run are missing.
    pub(super) fn refute_end(&mut self, run: u64) {
        let (end, missing) = (Loss::End.reason(), Loss::Output.reason());
        for (name, channel) in &mut self.run(run).channels {
            // A keyframe lags behind its tick.
            if *name != State::SERVICE.name()
                && let Some(count) = channel.excused.remove(&end)
            {
                *channel.missing.entry(missing.clone()).or_default() += count;
            }
        }
    }

    pub(super) fn recomputed(&mut self, TickId { run, tick }: TickId) {
        let run = self.run(run);
        let follows = |(_, last): &&mut (u64, u64)| last.checked_add(1) == Some(tick);
        if let Some((_, last)) = run.recomputed.last_mut().filter(follows) {
            *last = tick;
        } else if run.recomputed.len() < MAX_RANGES {
            run.recomputed.push((tick, tick));
        } else {
            run.ranges_omitted += 1;
        }
    }

    pub(super) fn into_runs(mut self) -> Vec<RunCoverage> {
        // Messages of no run are counted with the first one.
        let is_of_none = self.runs.len() > 1 && self.runs.get(&0).is_some_and(|run| run.ticks == 0);
        if is_of_none
            && let Some(of_none) = self.runs.remove(&0)
            && let Some(mut first) = self.runs.first_entry()
        {
            for (name, channel) in of_none.channels {
                first.get_mut().channels.entry(name).or_default().add(channel);
            }
        }
        self.runs.into_values().collect()
    }
}

impl fmt::Display for RunCoverage {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ranges: Vec<String> = match &self.recomputed[..] {
            [] => vec!["none".to_owned()],
            ranges => {
                let shown = ranges.iter().take(8);
                shown.map(|(first, last)| format!("{first} to {last}")).collect()
            }
        };
        let further = (self.recomputed.len() as u64).saturating_sub(8) + self.ranges_omitted;
        write!(out, "run {}: recomputed ticks {}", self.worker_epoch, ranges.join(", "))?;
        if further > 0 {
            write!(out, " and {further} more ranges")?;
        }
        writeln!(out)?;
        for (name, channel) in &self.channels {
            let ChannelCoverage { sent, recomputed, compared, excused, missing } = channel;
            write!(out, "  {name}: {sent} sent, {recomputed} recomputed, {compared} compared")?;
            for (what, reasons) in [("excused", excused), ("not compared", missing)] {
                for (reason, count) in reasons {
                    write!(out, ", {count} {what}: {reason}")?;
                }
            }
            writeln!(out)?;
        }
        Ok(())
    }
}
