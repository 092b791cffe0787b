//! Verification: recomputes everything that a worker published from its samples, and compares it
//! bit for bit.
//!
//! ```no_run
//! use joulebus_capture_format::Reader;
//! use joulebus_capture_verify::{Verification, Verifier};
//! # use joulebus_predictor::Model;
//! # use joulebus_settings::FleetSettings;
//!
//! // `settings` and `models` are the worker's: a capture has its config and its models.
//! fn verified(
//!     settings: FleetSettings,
//!     models: Vec<Model>,
//! ) -> Result<Verification, Box<dyn std::error::Error>> {
//!     let mut verifier = Verifier::new(settings, models)?;
//!     let mut reader = Reader::open("lab.mcap")?;
//!     while let Some(entry) = reader.next_entry()? {
//!         verifier.push(entry);
//!     }
//!     Ok(verifier.finish())
//! }
//! ```
//!
//! The worker's journal states which frames of samples each tick took at which time. A keyframe has
//! the fleet's state before a tick. From there the tick is a pure function. So a recording that
//! begins in the middle, or has a gap, is verified from its next keyframe on.
//!
//! The program `joulebus` has this crate as `joulebus replay --verify`.
//!
//! **Three types to know.** A [`Verifier`] takes the messages of a capture. A [`Verification`]
//! states how many ticks were recomputed, what differs, and what could not be compared. [`WhatIf`]
//! compares two models on the samples of a capture, and returns a [`Comparison`].
//!
//! **Units** are those of `joulebus-wire`: SI, and ns for times.
//!
//! **Errors.** Only the start can fail, for settings that are inconsistent. A loss, a refused
//! keyframe and a difference are results: [`Verification::is_clean`] states whether there is none.
//!
//! **In the book**: [record everything, and replay it][1], [a journal of ticks and keyframes][2],
//! [the same bits, live and offline][3].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/how-to/captures.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/tick-journal.md
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/determinism.md
#![forbid(unsafe_code)]

mod assemble;
mod compare;
mod output;
mod queries;
mod report;
mod what_if;

use std::collections::{BTreeMap, VecDeque};

use joulebus_fleet::{Fleet, FleetState};
use joulebus_predictor::Model;
use joulebus_settings::{FleetSettings, SettingsError};
use joulebus_wire::{ANSWER_RULES, ForecastHeader, TakenFrame, TickHeader, Ticks, tick_flag};

use assemble::{Assembler, Event, SampleFrame, TickParts};
use joulebus_capture_format::{Entry, MessageKind, Query};
use queries::Queries;

pub use compare::Value;
pub use output::{Output, RecomputedTick};
pub use report::{Difference, Loss, Verification};
pub use what_if::{Comparison, ModelScores, RobotComparison, WhatIf};

/// Maximum memory of ticks waiting for a keyframe, and of keyframes waiting for their ticks, bytes.
const MAX_WAITING: usize = 256 << 20;
/// Maximum number of keyframes waiting for their ticks: one arrives every five seconds, and its
/// ticks directly after it.
const MAX_KEYFRAMES: usize = 64;

/// Recomputes a capture of one fleet.
#[derive(Debug)]
pub struct Verifier {
    fleet: Fleet,
    /// The tick that `fleet` has just computed: run and number. `None` without a known state.
    at: Option<(u64, u64)>,
    assembler: Assembler,
    /// Ticks of one run that wait for a keyframe.
    waiting: VecDeque<Waiting>,
    waiting_bytes: usize,
    keyframes: BTreeMap<(u64, u64), Vec<u8>>,
    sequences: BTreeMap<String, u32>,
    queries: Queries,
    report: Verification,
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
            fleet: Fleet::new(settings, models)?,
            at: None,
            assembler: Assembler::new(outputs),
            waiting: VecDeque::new(),
            waiting_bytes: 0,
            keyframes: BTreeMap::new(),
            sequences: BTreeMap::new(),
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
        self.queries.has_other_rules = number != Some(ANSWER_RULES);
        self
    }

    /// Takes the next message of the fleet's channels. Of split files in their order.
    pub fn push(&mut self, entry: Entry) {
        self.count(&entry);
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
        self.queries.finish(&mut self.report);
        self.report.broken_keyframes = self.assembler.broken_keyframes;
        self.report.untaken_frames = self.assembler.untaken_frames();
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
                Event::Keyframe { worker_epoch, tick, bytes } => {
                    self.report.keyframes += 1;
                    // A keyframe of a tick that is already computed is redundant.
                    if self.at.is_none_or(|at| at < (worker_epoch, tick)) {
                        self.keep((worker_epoch, tick), bytes);
                    }
                }
                Event::Tick { worker_epoch, tick, parts } => {
                    self.tick(Waiting { worker_epoch, tick, parts });
                }
            }
            self.resume();
        }
    }

    /// Stores a keyframe until its tick arrives. The oldest ones are dropped if there are too many.
    fn keep(&mut self, place: (u64, u64), bytes: Vec<u8>) {
        self.keyframes.insert(place, bytes);
        let held =
            |keyframes: &BTreeMap<_, Vec<u8>>| keyframes.values().map(Vec::len).sum::<usize>();
        while self.keyframes.len() > 1
            && (self.keyframes.len() > MAX_KEYFRAMES || held(&self.keyframes) > MAX_WAITING)
        {
            self.keyframes.pop_first();
        }
    }

    fn tick(&mut self, next: Waiting) {
        let place = (next.worker_epoch, next.tick);
        self.report.note_tick(place);
        match self.at {
            Some((run, tick)) if (run, tick + 1) == place => self.compute(next),
            // Before the keyframe, or the last, partly published tick of a worker that was
            // replaced.
            Some(at) if place <= at => self.give_up(&next),
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
        let lack = match self.lack(tick) {
            Some(Loss::End) => Loss::End,
            // At the beginning of a recording, something is always missing.
            Some(lack) if self.report.has_begun => lack,
            _ => Loss::NoKeyframe,
        };
        self.report.lose((tick.worker_epoch, tick.tick), lack);
    }

    /// Continues from the first keyframe that waiting ticks follow.
    fn resume(&mut self) {
        while let Some(first) = self.waiting.front() {
            let run = first.worker_epoch;
            let from = (run, first.tick.saturating_sub(1));
            let Some(&(_, tick)) =
                self.keyframes.range(from..=(run, u64::MAX)).next().map(|(key, _)| key)
            else {
                return;
            };
            while self.waiting.front().is_some_and(|first| first.tick <= tick) {
                self.give_up_first();
            }
            let Some(bytes) = self.keyframes.remove(&(run, tick)) else {
                return;
            };
            if let Err(error) =
                FleetState::decode(&bytes).and_then(|state| self.fleet.restore_state(&state))
            {
                self.report.refuse_keyframe(tick, &error);
                continue;
            }
            self.at = Some((run, tick));
            self.catch_up();
        }
    }

    /// Computes consecutive waiting ticks.
    fn catch_up(&mut self) {
        while let (Some(first), Some((run, tick))) = (self.waiting.front(), self.at) {
            if (first.worker_epoch, first.tick) != (run, tick + 1) {
                // A tick is missing completely.
                self.at = None;
                return;
            }
            self.waiting_bytes -= first.parts.bytes();
            if let Some(first) = self.waiting.pop_front() {
                self.compute(first);
            }
        }
    }

    /// Missing inputs of a tick.
    fn lack(&self, next: &Waiting) -> Option<Loss> {
        let place = (next.worker_epoch, next.tick);
        let Some(journal) = &next.parts.journal else {
            let kind = MessageKind::of::<Ticks>();
            return Some(self.assembler.lack(place, kind, Loss::Journal));
        };
        if journal.header.unlisted > 0 {
            return Some(Loss::Unlisted);
        }
        if let Some((source_id, _, frame_seq)) = next.parts.ambiguous {
            return Some(Loss::Ambiguous { source_id, frame_seq });
        }
        let mut frames = journal.rows.iter().zip(&next.parts.frames);
        frames.find_map(|(taken, frame)| match frame {
            None if taken.new_normal_of().is_some() => None,
            None => Some(self.assembler.lack_of_frame(place, taken)),
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

    fn compute(&mut self, next: Waiting) {
        let place = (next.worker_epoch, next.tick);
        let lack = self.lack(&next);
        let parts = *next.parts;
        let (None, Some(journal)) = (lack, &parts.journal) else {
            self.at = None;
            return self.report.lose(place, lack.unwrap_or(Loss::Journal));
        };
        self.at = Some(place);
        self.keyframes = self.keyframes.split_off(&(place.0, place.1 + 1));
        take(&mut self.fleet, &journal.rows, &parts.frames);
        let journal = &journal.header;
        let intake = &tick(&mut self.fleet, journal);
        let (fleet, report) = (&self.fleet, &mut self.report);
        report.verified(fleet.len());
        let computed = RecomputedTick { fleet, journal, intake };
        for output in self.assembler.outputs() {
            if let Some(recorded) = parts.output(output.kind) {
                output.compare(computed, recorded, &mut |what, robot, difference| {
                    report.differ(place, what, robot, difference);
                });
            }
        }
        let plans = journal.flags & tick_flag::PLAN_STATES != 0;
        self.queries.ticked(place, fleet, plans, report);
        for output in self.assembler.outputs() {
            if parts.output(output.kind).is_none() && (output.is_sent)(journal) {
                let loss = self.assembler.lack(place, output.kind, Loss::Output);
                report.lack_output(output.kind, place, loss);
            }
        }
    }
}

/// Takes the frames and the new normals like the worker.
fn take(fleet: &mut Fleet, taken: &[TakenFrame], frames: &[Option<SampleFrame>]) {
    for (taken, frame) in taken.iter().zip(frames) {
        if let Some(robot) = taken.new_normal_of() {
            fleet.take_as_normal(robot);
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
    let (first_intended_ns, first_sent_ns, first_taken_ns) = intake.first.unwrap_or_default();
    ForecastHeader {
        model_hash: fleet.model_hash(),
        capacity: fleet.capacity(),
        frames_taken: intake.frames,
        first_intended_ns,
        first_sent_ns,
        first_taken_ns,
        compute_start_ns: journal.start_ns,
        samples_accepted: fleet.accepted(),
        samples_dropped: fleet.drops(),
        ..ForecastHeader::default()
    }
}
