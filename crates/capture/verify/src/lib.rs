#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod assemble;
mod compare;
mod coverage;
mod keyframes;
mod loss;
mod output;
mod queries;
mod refusals;
mod report;
mod robots;
mod tick_id;
mod what_if;

use std::collections::{BTreeMap, VecDeque};

use joulebus_fleet::{Fleet, FleetState};
use joulebus_predictor::Model;
use joulebus_settings::{FleetSettings, SettingsError};
use joulebus_wire::{
    ANSWER_RULES, Acknowledgements, Budgets, Channel as _, ForecastHeader, PlanStates, State,
    StateHeader, TICK_RULES, TakenFrame, TickHeader, Ticks, tick_flag,
};

use assemble::{Assembler, Event, SampleFrame, TickParts};
use coverage::Settled;
use joulebus_capture_format::{Entry, MessageKind, Query};
use keyframes::{Sequence, States};
use output::has_same_bits;
use queries::Queries;
use robots::RobotRows;
use tick_id::TickId;

pub use compare::Value;
pub use coverage::{ChannelCoverage, RunCoverage};
pub use loss::Loss;
pub use output::{Output, RecomputedTick, is_comparable};
pub use report::{Difference, Verdict, Verification};
pub use what_if::{Comparison, ModelScores, RobotComparison, WhatIf};

/// Maximum memory of ticks waiting for a keyframe, and of keyframes waiting for their ticks, bytes.
const MAX_WAITING: usize = 256 << 20;
/// Maximum number of keyframes waiting for their ticks: one arrives every five seconds, and its
/// ticks directly after it.
const MAX_KEYFRAMES: usize = 64;
/// Maximum time from the first tick of a recording to its first keyframe, ns. A worker sends a
/// keyframe to each new recorder at once, and else every five seconds.
const MAX_BEGINNING_NS: u64 = 10_000_000_000;
/// The same where the recording has the first tick of the run. The recorder was there before it, so
/// that the state before it was sent, or came while that was being sent, and got another at once.
const MAX_FIRST_KEYFRAME_NS: u64 = 1_000_000_000;
/// Time between two keyframes, ns, and the number of times as long as a worker took to send one that
/// it waits for the next.
const KEYFRAME_EVERY_NS: u64 = 5_000_000_000;
const KEYFRAME_TIME_FACTOR: u64 = 100;
/// The first [`TICK_RULES`] whose keyframes have this version's encoding.
const ENCODED_SINCE: u32 = 11;
/// Rules of answers, and the first [`TICK_RULES`] that came with them.
const ANSWERED_SINCE: u32 = 4;
const ANSWERED_WITH: u32 = 7;
/// The first [`TICK_RULES`] of which each keyframe names the one before it.
const NAMED_SINCE: u32 = 7;
/// Maximum time that a keyframe may take to be sent, ns: what states more is not believed.
const MAX_KEYFRAME_TIME_NS: u64 = 10_000_000_000;
/// Maximum time between two ticks that counts for the pace of keyframes, ns: a process that was
/// stopped sends none.
const MAX_TICK_NS: u64 = 1_000_000_000;

/// Recomputes a capture of one fleet.
#[derive(Debug)]
pub struct Verifier {
    fleet: Fleet,
    /// The tick that `fleet` has just computed. `None` without a known state.
    at: Option<TickId>,
    assembler: Assembler,
    /// Ticks of one run that wait for a keyframe.
    waiting: VecDeque<Waiting>,
    waiting_bytes: usize,
    keyframes: BTreeMap<TickId, Vec<u8>>,
    states: States,
    beginning: Beginning,
    pace: Pace,
    /// First and last tick of each run.
    spans: BTreeMap<u64, (u64, u64)>,
    sequences: BTreeMap<String, u32>,
    robot_rows: RobotRows,
    queries: Queries,
    tick_rules: u32,
    answer_rules: Option<u32>,
    period_ns: Option<u64>,
    report: Verification,
}

/// The beginning of a recording, where the worker's state is unknown.
#[derive(Debug, Default)]
struct Beginning {
    /// The first tick with a journal.
    first: Option<TickId>,
    /// Start of the first tick, and of the newest one, monotonic ns.
    times: Option<(u64, u64)>,
    /// The first keyframe from which ticks can be recomputed: later ticks are not excused.
    until: Option<TickId>,
}

impl Beginning {
    fn note(&mut self, id: TickId, start_ns: Option<u64>) {
        let Some(start_ns) = start_ns else {
            return;
        };
        if self.first.is_none() {
            self.first = Some(id);
            // A keyframe of an earlier tick may come first.
            self.until.take().into_iter().for_each(|keyframe| self.end(keyframe));
        }
        let (from_ns, newest_ns) = self.times.unwrap_or((start_ns, start_ns));
        self.times = Some((from_ns, newest_ns.max(start_ns)));
    }

    /// Ends with the keyframe of a tick, unless the ticks that follow it were not recorded.
    fn end(&mut self, id: TickId) {
        let is_usable =
            self.first.is_none_or(|first| TickId::new(id.run, id.tick.saturating_add(1)) >= first);
        if is_usable {
            self.until.get_or_insert(id);
        }
    }

    /// True if the keyframe that ends it was taken before the recording began.
    fn is_before_first(&self) -> bool {
        let (Some(first), Some(until)) = (self.first, self.until) else {
            return false;
        };
        until < first && !self.has_first_tick()
    }

    /// True if the recording has the first tick of its first run.
    fn has_first_tick(&self) -> bool {
        self.first.is_some_and(|first| first.tick <= 1)
    }

    /// True if it is excused that the state before the tick is unknown.
    fn has(&self, id: TickId, start_ns: Option<u64>) -> bool {
        let (from_ns, newest_ns) = self.times.unwrap_or_default();
        let at_ns = start_ns.unwrap_or(newest_ns);
        let max_ns = if self.has_first_tick() { MAX_FIRST_KEYFRAME_NS } else { MAX_BEGINNING_NS };
        self.first.is_none_or(|first| id.run == first.run)
            && self.until.is_none_or(|until| id <= until)
            && at_ns.saturating_sub(from_ns) <= max_ns
    }
}

/// The time since the last keyframe of the newest run.
#[derive(Debug, Default)]
struct Pace {
    run: u64,
    /// Start of the newest tick, monotonic ns.
    newest_ns: Option<u64>,
    since_ns: u64,
    /// Time that the next keyframe may take.
    allowed_ns: u64,
}

impl Pace {
    fn note(&mut self, header: &StateHeader) {
        let took_ns = header.sent_ns.saturating_sub(header.taken_ns).min(MAX_KEYFRAME_TIME_NS);
        let every_ns = KEYFRAME_EVERY_NS.max(KEYFRAME_TIME_FACTOR * took_ns);
        (self.since_ns, self.allowed_ns) = (0, 2 * every_ns + KEYFRAME_EVERY_NS);
    }

    /// True if a keyframe should have come before a tick of `run`. The next one is then awaited.
    fn lacks_one(&mut self, run: u64, start_ns: Option<u64>) -> bool {
        if run != self.run {
            *self = Self { run, allowed_ns: 3 * KEYFRAME_EVERY_NS, ..Self::default() };
        }
        let Some(start_ns) = start_ns else {
            return false;
        };
        let newest_ns = self.newest_ns.replace(start_ns).unwrap_or(start_ns);
        self.since_ns += start_ns.saturating_sub(newest_ns).min(MAX_TICK_NS);
        let lacks = self.since_ns > self.allowed_ns;
        if lacks {
            self.since_ns = 0;
        }
        lacks
    }
}

#[derive(Debug)]
struct Waiting {
    worker_epoch: u64,
    tick: u64,
    parts: Box<TickParts>,
}

impl Verifier {
    /// With the worker's settings and models: `models[i]` is that of `settings.platforms[i]`.
    ///
    /// # Errors
    /// As [`Fleet::new`].
    pub fn new(settings: FleetSettings, models: Vec<Model>) -> Result<Self, SettingsError> {
        let queries = Queries::new(&settings, &models);
        let (outputs, mut report) = (Output::all(), Verification::default());
        outputs.iter().for_each(|output| report.expect(output.kind));
        Ok(Self {
            queries,
            states: States::new(&settings),
            fleet: Fleet::new(settings, models)?,
            at: None,
            assembler: Assembler::new(outputs),
            waiting: VecDeque::new(),
            waiting_bytes: 0,
            keyframes: BTreeMap::new(),
            beginning: Beginning::default(),
            pace: Pace::default(),
            spans: BTreeMap::new(),
            sequences: BTreeMap::new(),
            robot_rows: RobotRows::default(),
            tick_rules: TICK_RULES,
            answer_rules: None,
            period_ns: None,
            report,
        })
    }

    /// Also compares a channel that is declared elsewhere.
    #[must_use]
    pub fn with_output(mut self, output: Output) -> Self {
        self.report.expect(output.kind);
        self.assembler.add_output(output);
        self
    }

    /// A recording whose answers about plans were computed by the rules of this number
    /// ([`joulebus_wire::ANSWER_RULES`]), `None` if by several: those of other rules are counted,
    /// and not compared.
    #[must_use]
    pub fn with_answer_rules(mut self, number: Option<u32>) -> Self {
        self.queries.has_other_rules |= number != Some(ANSWER_RULES);
        self.answer_rules = number;
        self
    }

    /// A recording whose ticks were computed by the rules of this number
    /// ([`joulebus_wire::TICK_RULES`]): channels that have other bits by them are not compared.
    #[must_use]
    pub fn with_tick_rules(mut self, number: u32) -> Self {
        self.tick_rules = number;
        // Answers are computed from these.
        let sources = [PlanStates::SERVICE.name(), Budgets::SERVICE.name()];
        let is_other = sources.iter().any(|channel| !has_same_bits(channel, number));
        self.queries.has_other_rules |= is_other;
        self
    }

    /// Also compares the period of the worker's ticks, ns, which headers state.
    #[must_use]
    pub fn with_period_ns(mut self, period_ns: u64) -> Self {
        self.period_ns = Some(period_ns);
        self.queries.period_ns = Some(period_ns);
        self
    }

    /// Takes the next message of the fleet's channels. Of split files in their order.
    pub fn push(&mut self, entry: Entry) {
        self.count(&entry);
        if let Some((channel, tick)) = self.robot_rows.take(&entry.message) {
            self.report.contradict(tick, Loss::Differing(channel));
        }
        if let Some(frame) = entry.message.frame::<Acknowledgements>() {
            self.queries.take_acknowledged((&frame.header, &frame.rows), &mut self.report);
        }
        match entry.message.take::<Query>() {
            Ok(query) => self.queries.take(query, &entry.fleet, &mut self.report),
            Err(message) => self.assembler.push(message),
        }
        self.work();
    }

    /// Ends the input.
    #[must_use]
    pub fn finish(mut self) -> Verification {
        self.assembler.finish();
        self.work();
        self.give_up_waiting();
        for (id, _) in std::mem::take(&mut self.keyframes) {
            self.leave_keyframe(id);
        }
        let is_new = self.answer_rules.map(|rules| rules >= ANSWERED_SINCE);
        if is_new.is_some_and(|is_new| is_new != (self.tick_rules >= ANSWERED_WITH)) {
            self.report.deny_rules(0, self.tick_rules);
        }
        let last_tick = |run| self.assembler.last_tick(run);
        self.queries.finish(last_tick, &mut self.report);
        self.report.untaken_frames = self.assembler.untaken_frames();
        self.report.check_ends(last_tick);
        self.report.close();
        self.report
    }

    fn count(&mut self, entry: &Entry) {
        let report = &mut self.report;
        report.messages += 1;
        report.note_time(entry.log_time_ns);
        let Some(kind) = entry.message.kind() else {
            return;
        };
        report.note_kind(kind);
        if let Some(last) = self.sequences.get_mut(&*entry.topic) {
            let lost = entry.sequence.wrapping_sub(*last).wrapping_sub(1);
            // Numbers that decrease belong to another recording, which is no loss.
            if lost < u32::MAX / 2 {
                report.messages_lost += u64::from(lost);
            }
            *last = entry.sequence;
        } else {
            self.sequences.insert(entry.topic.to_string(), entry.sequence);
        }
    }

    fn work(&mut self) {
        while let Some(event) = self.assembler.next_event() {
            match event {
                Event::Keyframe { header, bytes } => self.keyframe(&header, bytes),
                Event::Broken { worker_epoch, tick, is_cut_off } => {
                    self.states.note_broken(worker_epoch);
                    self.report.broken_keyframes += u64::from(!is_cut_off);
                    self.beginning.end(TickId::new(worker_epoch, tick));
                    let why = if is_cut_off { Loss::End } else { Loss::Broken };
                    self.settle_keyframe(TickId::new(worker_epoch, tick), &Settled::Not(why));
                }
                Event::Contradiction { tick, why } => self.report.contradict(tick, why),
                Event::Tick { worker_epoch, tick, parts } => {
                    self.tick(Waiting { worker_epoch, tick, parts });
                }
            }
            self.resume();
        }
    }

    /// Compares a keyframe with the state after its tick, or stores it until then.
    fn keyframe(&mut self, header: &StateHeader, bytes: Vec<u8>) {
        let id = TickId::new(header.worker_epoch, header.tick);
        // A later run began during the recording, with a keyframe that names none.
        let is_first = self.beginning.first.is_none_or(|first| id.run <= first.run);
        let names = (is_first, self.tick_rules >= NAMED_SINCE);
        match self.states.sequence(id, header.before_hash, &bytes, names) {
            Sequence::Copy => return,
            Sequence::Differs => {
                let why = Loss::Differing(State::SERVICE.name());
                return self.report.contradict(id.tick, why);
            }
            Sequence::Gap => self.report.missing_keyframes += 1,
            Sequence::Follows => {}
        }
        self.pace.note(header);
        let is_new = FleetState::is_of_this_version(&bytes);
        if is_new != (self.tick_rules >= ENCODED_SINCE) {
            self.report.deny_rules(id.tick, self.tick_rules);
        }
        self.report.keyframes += 1;
        self.beginning.end(id);
        if self.states.is_known(id) {
            self.compare_keyframe(id, &bytes);
        } else if self.at.is_none_or(|at| at < id) {
            self.keep(id, bytes);
        } else {
            self.leave_keyframe(id);
        }
    }

    /// Compares a keyframe with the state after its tick, which was recomputed.
    fn compare_keyframe(&mut self, id: TickId, bytes: &[u8]) {
        if !has_same_bits(State::SERVICE.name(), self.tick_rules) {
            return self.settle_keyframe(id, &Settled::Not(Loss::OlderRules(self.tick_rules)));
        }
        if let Some((recorded, computed)) = self.states.difference(id, bytes) {
            let what = State::SERVICE.name();
            self.report.differ(id, what, None, ("hash", recorded.into(), computed.into()));
            if let Err(error) = FleetState::decode(bytes) {
                self.report.refuse_keyframe(id.tick, &error);
            }
        }
        self.settle_keyframe(id, &Settled::Compared);
    }

    /// Counts a keyframe whose tick was not recomputed.
    fn leave_keyframe(&mut self, id: TickId) {
        let TickId { run, tick } = id;
        let span = self.spans.get(&run).copied();
        let why = match span {
            // The state from which a worker began that was ended before its first tick.
            None if tick == 0 => Loss::Given,
            None if self.beginning.first.is_some_and(|first| id < first) => Loss::Before,
            Some((first, _)) if tick < first => Loss::Before,
            Some((_, last)) if tick <= last && !self.states.is_forgotten(id) => Loss::NotRecomputed,
            _ => Loss::NoTick,
        };
        if why == Loss::NoTick {
            self.report.contradict(tick, why);
        }
        self.settle_keyframe(id, &Settled::Not(why));
    }

    fn settle_keyframe(&mut self, id: TickId, settled: &Settled) {
        self.report.settle(id, MessageKind::of::<State>(), settled);
    }

    /// Stores a keyframe until its tick arrives. The oldest ones are dropped if there are too many.
    fn keep(&mut self, id: TickId, bytes: Vec<u8>) {
        self.keyframes.insert(id, bytes);
        let held =
            |keyframes: &BTreeMap<_, Vec<u8>>| keyframes.values().map(Vec::len).sum::<usize>();
        while self.keyframes.len() > 1
            && (self.keyframes.len() > MAX_KEYFRAMES || held(&self.keyframes) > MAX_WAITING)
            && let Some((oldest, _)) = self.keyframes.pop_first()
        {
            self.leave_keyframe(oldest);
        }
    }

    fn tick(&mut self, next: Waiting) {
        let id = TickId::new(next.worker_epoch, next.tick);
        let start_ns = next.start_ns();
        let is_first_run = self.spans.is_empty();
        let begins_inside = !is_first_run || self.keyframes.contains_key(&TickId { tick: 0, ..id });
        let absent = match self.spans.get_mut(&id.run) {
            // A copy of a part of a tick that was released long ago.
            Some((_, last)) if next.tick <= *last => {
                return self.report.contradict(next.tick, Loss::Stray(Ticks::SERVICE.name()));
            }
            Some((_, last)) => next.tick - std::mem::replace(last, next.tick) - 1,
            // A recording begins with its first journal: a new reader of some channels receives
            // the newest frame, which may be of a tick long before.
            None if is_first_run && start_ns.is_none() => 0,
            None => {
                self.spans.insert(id.run, (next.tick, next.tick));
                if begins_inside { next.tick.saturating_sub(1) } else { 0 }
            }
        };
        self.report.note_tick(id, absent);
        self.report.missing_keyframes += u64::from(self.pace.lacks_one(id.run, start_ns));
        self.beginning.note(id, start_ns);
        self.queries.first = self.beginning.first;
        if let Some(start_ns) = start_ns {
            self.queries.refusals.note_tick(id.run, start_ns);
        }
        match self.at {
            Some(at) if at.is_followed_by(id) => self.compute(&next),
            // Before the keyframe, or the last, partly published tick of a worker that was
            // replaced.
            Some(at) if id <= at => self.give_up(&next),
            _ => self.wait(next),
        }
    }

    /// Stores a tick until a keyframe arrives.
    fn wait(&mut self, next: Waiting) {
        if self.waiting.front().is_some_and(|first| first.worker_epoch != next.worker_epoch) {
            self.give_up_waiting();
        }
        self.waiting_bytes += next.parts.bytes();
        self.waiting.push_back(next);
        while self.waiting_bytes > MAX_WAITING {
            self.give_up_first();
        }
    }

    fn give_up_waiting(&mut self) {
        while !self.waiting.is_empty() {
            self.give_up_first();
        }
    }

    /// The state before the first waiting tick is unknown, and will remain so.
    fn give_up_first(&mut self) {
        let Some(first) = self.waiting.pop_front() else {
            return;
        };
        self.waiting_bytes -= first.parts.bytes();
        self.give_up(&first);
    }

    fn give_up(&mut self, tick: &Waiting) {
        let id = TickId::new(tick.worker_epoch, tick.tick);
        let lack = match self.lack(tick) {
            Some(Loss::End) => Loss::End,
            // At the beginning of a recording, something is always missing.
            _ if self.beginning.has(id, tick.start_ns()) => Loss::Before,
            Some(lack) => lack,
            None => Loss::NoKeyframe,
        };
        self.lose(id, &tick.parts, lack);
    }

    /// Counts a tick that is not recomputed, and the frames that it sent.
    fn lose(&mut self, id: TickId, parts: &TickParts, why: Loss) {
        self.report.lose(id, why);
        let journal = parts.journal.as_ref().map(|journal| &journal.header);
        for output in self.assembler.outputs() {
            let is_sent = journal.is_some_and(|journal| output.kind.is_sent_in(journal));
            if is_sent || parts.output(output.kind).is_some() {
                self.report.settle(id, output.kind, &Settled::Not(why));
            }
        }
    }

    /// Continues from the first keyframe that waiting ticks follow.
    ///
    /// 1. Give up the ticks that the keyframe contains: nothing before it can be computed.
    /// 2. Restore the fleet from the keyframe. One that is refused is reported, and the next tried.
    /// 3. [`Verifier::catch_up`] computes waiting ticks while they follow each other.
    /// 4. At the first gap the fleet is lost, and the next keyframe is awaited.
    fn resume(&mut self) {
        while let Some(first) = self.waiting.front() {
            let run = first.worker_epoch;
            let from = TickId::new(run, first.tick.saturating_sub(1));
            let until = TickId::new(run, u64::MAX);
            let Some((&id, _)) = self.keyframes.range(from..=until).next() else {
                return;
            };
            while self.waiting.front().is_some_and(|first| first.tick <= id.tick) {
                self.give_up_first();
            }
            let Some(bytes) = self.keyframes.remove(&id) else {
                return;
            };
            self.beginning.end(id);
            if let Err(error) =
                FleetState::decode(&bytes).and_then(|state| self.fleet.restore_state(&state))
            {
                self.report.refuse_keyframe(id.tick, &error);
                self.settle_keyframe(id, &Settled::Not(Loss::Refused));
                continue;
            }
            self.settle_keyframe(id, &Settled::Not(Loss::Given));
            self.at = Some(id);
            self.catch_up();
        }
    }

    /// Computes consecutive waiting ticks.
    fn catch_up(&mut self) {
        while let (Some(first), Some(at)) = (self.waiting.front(), self.at) {
            if !at.is_followed_by(TickId::new(first.worker_epoch, first.tick)) {
                // A tick is missing completely.
                self.at = None;
                return;
            }
            self.waiting_bytes -= first.parts.bytes();
            if let Some(first) = self.waiting.pop_front() {
                self.compute(&first);
            }
        }
    }

    /// Missing inputs of a tick.
    fn lack(&self, next: &Waiting) -> Option<Loss> {
        let id = TickId::new(next.worker_epoch, next.tick);
        let Some(journal) = &next.parts.journal else {
            let kind = MessageKind::of::<Ticks>();
            return Some(self.assembler.lack(id, kind, Loss::Journal));
        };
        if journal.header.unlisted > 0 {
            return Some(Loss::Unlisted);
        }
        if next.parts.differing.contains(&MessageKind::of::<Ticks>()) {
            return Some(Loss::Differing(Ticks::SERVICE.name()));
        }
        if let Some((source_id, _, frame_seq)) = next.parts.ambiguous {
            return Some(Loss::Ambiguous { source_id, frame_seq });
        }
        let mut frames = journal.rows.iter().zip(&next.parts.frames);
        frames.find_map(|(taken, frame)| match frame {
            None if !taken.is_frame() => None,
            None => Some(self.assembler.lack_of_frame(id, taken)),
            Some(frame) => {
                let sent = u64::from(taken.samples) + u64::from(taken.truncated);
                // The recorder missed the one that the worker took.
                (frame.rows.len() as u64 != sent).then_some(Loss::Ambiguous {
                    source_id: taken.source_id,
                    frame_seq: taken.frame_seq,
                })
            }
        })
    }

    fn compute(&mut self, next: &Waiting) {
        let id = TickId::new(next.worker_epoch, next.tick);
        let lack = self.lack(next);
        let (None, Some(_)) = (lack, &next.parts.journal) else {
            self.at = None;
            let lack = lack.unwrap_or(Loss::Journal);
            let is_before = matches!(lack, Loss::Beginning)
                && self.beginning.is_before_first()
                && Beginning { until: None, ..self.beginning }.has(id, next.start_ns());
            if is_before {
                // The next keyframe begins the recording.
                self.beginning.until = None;
            }
            let lack = match lack {
                Loss::Beginning if !is_before => Loss::NoKeyframe,
                lack => lack,
            };
            return self.lose(id, &next.parts, lack);
        };
        self.at = Some(id);
        let later = self.keyframes.split_off(&TickId::new(id.run, id.tick.saturating_add(1)));
        let reached = std::mem::replace(&mut self.keyframes, later);
        self.recompute(id, &next.parts);
        for (of, bytes) in reached {
            if of == id {
                self.compare_keyframe(id, &bytes);
            } else {
                self.leave_keyframe(of);
            }
        }
    }

    /// Computes a tick that has all its inputs, and compares its outputs.
    fn recompute(&mut self, id: TickId, parts: &TickParts) {
        let Some(journal) = &parts.journal else {
            return;
        };
        take(&mut self.fleet, &journal.rows, &parts.frames);
        let journal = &journal.header;
        let intake = &tick(&mut self.fleet, journal);
        let is_compared = has_same_bits(State::SERVICE.name(), self.tick_rules);
        self.states.note(id, &self.fleet, is_compared);
        let (fleet, report) = (&self.fleet, &mut self.report);
        report.verified(id, fleet.len());
        let computed = RecomputedTick { fleet, journal, intake, period_ns: self.period_ns };
        for output in self.assembler.outputs() {
            let (kind, is_sent) = (output.kind, output.kind.is_sent_in(journal));
            let settled = match parts.output(kind) {
                None if !is_sent => continue,
                None => {
                    let lack = self.assembler.lack(id, kind, Loss::Output);
                    report.lack_output(kind, id, lack);
                    Settled::Recomputed(lack)
                }
                Some(_) if !has_same_bits(kind.name(), self.tick_rules) && output.is_ours => {
                    Settled::Recomputed(Loss::OlderRules(self.tick_rules))
                }
                Some(_) if parts.differing.contains(&kind) => {
                    let why = Loss::Differing(kind.name());
                    report.contradict(id.tick, why);
                    Settled::Recomputed(why)
                }
                Some(recorded) => {
                    output.compare(computed, recorded, &mut |what, robot, difference| {
                        report.differ(id, what, robot, difference);
                    });
                    Settled::Compared
                }
            };
            if !is_sent {
                // The journal denies the frame.
                report.contradict(id.tick, Loss::Stray(kind.name()));
            }
            report.settle(id, kind, &settled);
        }
        let plans = journal.flags & tick_flag::PLAN_STATES != 0;
        self.queries.ticked(id, fleet, plans, report);
    }
}

impl Waiting {
    /// When the tick began, monotonic ns, if its journal was recorded.
    fn start_ns(&self) -> Option<u64> {
        self.parts.journal.as_ref().map(|journal| journal.header.start_ns)
    }
}

/// Takes the frames, the ends of sources and the statements like the worker.
fn take(fleet: &mut Fleet, taken: &[TakenFrame], frames: &[Option<SampleFrame>]) {
    for (taken, frame) in taken.iter().zip(frames) {
        if let Some((robot, stated)) = taken.statement() {
            fleet.take_statement(robot, stated, taken.taken_ns);
        }
        if let Some((source_id, epoch)) = taken.ended_source() {
            fleet.end_source(source_id, epoch);
        }
        let Some(frame) = frame else {
            continue;
        };
        let looked_at = frame.rows.len().min(taken.samples as usize);
        fleet.take(&frame.header, &frame.rows[..looked_at], taken.taken_ns);
    }
}

/// Ticks, and returns the worker's header fields about the intake.
fn tick(fleet: &mut Fleet, journal: &TickHeader) -> ForecastHeader {
    let missed = journal.flags & tick_flag::DEADLINE_MISSED != 0;
    let intake = fleet.tick(journal.start_ns, missed);
    fleet.header(intake, journal.start_ns)
}
