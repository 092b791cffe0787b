//! Puts the parts of each tick together: in a capture they lie in the order in which the recorder
//! came across them.

use std::collections::{BTreeMap, HashMap, VecDeque};

use joulebus_wire::{
    Budget, BudgetHeader, Diagnostic, DiagnosticHeader, Forecast, ForecastHeader, Sample,
    SampleHeader, StateHeader, TakenFrame, TickHeader, tick_flag,
};

use super::report::Loss;
use crate::{Message, MessageKind};

/// Ticks that a recorder may run ahead in one service before it looks at another: more than any
/// service has capacity for.
const WINDOW: u64 = 64;
/// Frames of samples that may wait for the tick that took them.
const MOST_FRAMES: usize = 8_192;
/// Samples in them, in all: 224 MB.
const MOST_SAMPLES: usize = 4_000_000;

/// One frame of samples.
pub(super) type SampleFrame = (SampleHeader, Vec<Sample>);

/// What was recorded of one tick.
#[derive(Debug, Default)]
pub(super) struct TickParts {
    pub(super) journal: Option<(TickHeader, Vec<TakenFrame>)>,
    /// The frames of the journal, in its order; none where the capture lacks one.
    pub(super) frames: Vec<Option<SampleFrame>>,
    pub(super) forecasts: Option<(ForecastHeader, Vec<Forecast>)>,
    pub(super) diagnostics: Option<(DiagnosticHeader, Vec<Diagnostic>)>,
    pub(super) budgets: Option<(BudgetHeader, Vec<Budget>)>,
}

/// The next thing that a capture says of a worker's run.
#[derive(Debug)]
pub(super) enum Event {
    /// A tick with all that there is of it. Ticks of a run come in order.
    Tick {
        worker_epoch: u64,
        tick: u64,
        parts: Box<TickParts>,
    },
    /// A whole keyframe: the state after `tick`.
    Keyframe {
        worker_epoch: u64,
        tick: u64,
        bytes: Vec<u8>,
    },
}

/// Takes messages, gives events.
#[derive(Debug, Default)]
pub(super) struct Assembler {
    runs: BTreeMap<u64, Run>,
    frames: FrameStore,
    /// The newest of each kind, by run; and whether all has come.
    newest: HashMap<(u64, MessageKind), u64>,
    /// The oldest and the newest frame of each run of each source.
    frame_range: HashMap<(u64, u64), (u64, u64)>,
    /// Where the recording begins: run and tick.
    first: Option<(u64, u64)>,
    ended: bool,
    piece: Option<(StateHeader, Vec<u8>)>,
    /// Keyframes of which a piece is missing.
    pub(super) broken_keyframes: u64,
    events: VecDeque<Event>,
}

/// What waits of one run of the worker.
#[derive(Debug, Default)]
struct Run {
    ticks: BTreeMap<u64, TickParts>,
    newest: u64,
}

/// Frames that no tick has taken yet, and the order in which they came.
#[derive(Debug, Default)]
struct FrameStore {
    frames: HashMap<FrameKey, VecDeque<SampleFrame>>,
    order: VecDeque<FrameKey>,
    held: usize,
    samples: usize,
    untaken: u64,
}

type FrameKey = (u64, u64, u64);

impl Assembler {
    /// Takes a message; of other kinds nothing.
    pub(super) fn push(&mut self, message: Message) {
        match message {
            Message::Samples(header, samples) => self.put(header, samples),
            Message::Ticks(header, taken) => {
                let place = (header.worker_epoch, header.tick);
                self.parts(place, MessageKind::Ticks).journal = Some((header, taken));
            }
            Message::Forecasts(header, rows) => {
                let place = (header.worker_epoch, header.tick);
                self.parts(place, MessageKind::Forecasts).forecasts = Some((header, rows));
            }
            Message::Diagnostics(header, rows) => {
                let place = (header.worker_epoch, header.tick);
                self.parts(place, MessageKind::Diagnostics).diagnostics = Some((header, rows));
            }
            Message::Budgets(header, rows) => {
                let place = (header.worker_epoch, header.tick);
                self.parts(place, MessageKind::Budgets).budgets = Some((header, rows));
            }
            Message::State(header, bytes) => self.add_piece(header, &bytes),
            _ => return,
        }
        self.release(false);
    }

    /// There is no more: gives what waits.
    pub(super) fn finish(&mut self) {
        self.broken_keyframes += u64::from(self.piece.take().is_some());
        self.ended = true;
        self.release(true);
    }

    /// The next event, if one is complete.
    pub(super) fn next_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Frames of samples that no tick took, as far as the capture tells.
    pub(super) fn untaken_frames(&self) -> u64 {
        self.frames.untaken + self.frames.held as u64
    }

    /// Why a message of `kind` is missing: lost, or not there because the run ended.
    pub(super) fn lack(&self, (run, tick): (u64, u64), kind: MessageKind, lost: Loss) -> Loss {
        let newest = self.newest.get(&(run, kind)).copied().unwrap_or_default();
        if self.is_over(run, tick) && tick > newest {
            Loss::End
        } else {
            lost
        }
    }

    /// As [`Assembler::lack`], of a frame of samples.
    pub(super) fn lack_of_frame(&self, (run, tick): (u64, u64), taken: &TakenFrame) -> Loss {
        let (source_id, frame_seq) = (taken.source_id, taken.frame_seq);
        let range = self.frame_range.get(&(source_id, taken.source_epoch));
        if self.is_over(run, tick) && range.is_none_or(|(_, newest)| frame_seq > *newest) {
            Loss::End
        } else if self.is_young(run, tick) && range.is_none_or(|(oldest, _)| frame_seq < *oldest) {
            Loss::Beginning
        } else {
            Loss::Samples {
                source_id,
                frame_seq,
            }
        }
    }

    /// Whether nothing more comes of a run, and `tick` is among its last.
    fn is_over(&self, run: u64, tick: u64) -> bool {
        let newest = |kind| self.newest.get(&(run, kind)).copied().unwrap_or_default();
        let last = newest(MessageKind::Ticks).max(newest(MessageKind::Forecasts));
        let is_newest = self
            .runs
            .keys()
            .next_back()
            .is_none_or(|newest| *newest <= run);
        (self.ended || !is_newest) && tick + WINDOW > last
    }

    /// Whether `tick` is among the first of the recording.
    fn is_young(&self, run: u64, tick: u64) -> bool {
        self.first
            .is_some_and(|(first_run, first)| run == first_run && tick < first + WINDOW)
    }

    fn parts(&mut self, (worker_epoch, tick): (u64, u64), kind: MessageKind) -> &mut TickParts {
        let newest = self.newest.entry((worker_epoch, kind)).or_default();
        *newest = tick.max(*newest);
        self.first.get_or_insert((worker_epoch, tick));
        let run = self.runs.entry(worker_epoch).or_default();
        run.newest = run.newest.max(tick);
        run.ticks.entry(tick).or_default()
    }

    fn put(&mut self, header: SampleHeader, samples: Vec<Sample>) {
        let key = (header.source_id, header.source_epoch);
        let seq = header.frame_seq;
        let range = self.frame_range.entry(key).or_insert((seq, seq));
        *range = (seq.min(range.0), seq.max(range.1));
        self.frames.put(header, samples);
    }

    fn add_piece(&mut self, header: StateHeader, bytes: &[u8]) {
        let follows = |(first, sofar): &(StateHeader, Vec<u8>)| {
            (first.worker_epoch, first.tick) == (header.worker_epoch, header.tick)
                && sofar.len() as u64 == header.offset
        };
        if header.offset == 0 {
            let before = self.piece.replace((header, bytes.to_vec()));
            self.broken_keyframes += u64::from(before.is_some());
        } else if let Some((_, sofar)) = self.piece.as_mut().filter(|piece| follows(piece)) {
            sofar.extend_from_slice(bytes);
        } else {
            // The end of one whose beginning is missing.
            self.broken_keyframes += u64::from(self.piece.take().is_some());
            return;
        }
        if let Some((first, whole)) = self
            .piece
            .take_if(|(first, sofar)| sofar.len() as u64 >= first.total_bytes)
        {
            self.events.push_back(Event::Keyframe {
                worker_epoch: first.worker_epoch,
                tick: first.tick,
                bytes: whole,
            });
        }
    }

    /// Gives the ticks that are complete, and those that will never be.
    fn release(&mut self, all: bool) {
        let newest_run = self.runs.keys().next_back().copied().unwrap_or_default();
        let newest_tick = self.runs.get(&newest_run).map_or(0, |run| run.newest);
        for (worker_epoch, run) in &mut self.runs {
            // Of a run that another has followed for long nothing more comes.
            let over = all || (*worker_epoch < newest_run && newest_tick > WINDOW);
            while let Some(mut head) = run.ticks.first_entry() {
                self.frames.fill(head.get_mut());
                let (tick, parts) = (*head.key(), head.get());
                if !parts.is_complete() && !over && run.newest < tick + WINDOW {
                    break;
                }
                let parts = Box::new(head.remove());
                self.events.push_back(Event::Tick {
                    worker_epoch: *worker_epoch,
                    tick,
                    parts,
                });
            }
        }
        self.runs
            .retain(|worker_epoch, run| *worker_epoch == newest_run || !run.ticks.is_empty());
    }
}

impl TickParts {
    fn is_complete(&self) -> bool {
        let Some((header, _)) = &self.journal else {
            return false;
        };
        let sheds = header.flags & tick_flag::NO_DIAGNOSTICS != 0;
        self.frames.iter().all(Option::is_some)
            && self.forecasts.is_some()
            && (self.diagnostics.is_some() || sheds)
            && self.budgets.is_some()
    }

    /// Bytes that it takes, roughly.
    pub(super) fn bytes(&self) -> usize {
        let frames = self.frames.iter().flatten();
        frames
            .map(|(_, samples)| size_of_val(samples.as_slice()))
            .sum::<usize>()
            + self
                .forecasts
                .as_ref()
                .map_or(0, |(_, rows)| size_of_val(rows.as_slice()))
            + self
                .diagnostics
                .as_ref()
                .map_or(0, |(_, rows)| size_of_val(rows.as_slice()))
            + self
                .budgets
                .as_ref()
                .map_or(0, |(_, rows)| size_of_val(rows.as_slice()))
    }
}

impl FrameStore {
    fn put(&mut self, header: SampleHeader, samples: Vec<Sample>) {
        let key = (header.source_id, header.source_epoch, header.frame_seq);
        self.held += 1;
        self.samples += samples.len();
        self.order.push_back(key);
        self.frames
            .entry(key)
            .or_default()
            .push_back((header, samples));
        while self.held > MOST_FRAMES || (self.samples > MOST_SAMPLES && self.held > 1) {
            let Some(oldest) = self.order.pop_front() else {
                return;
            };
            self.untaken += u64::from(self.get(oldest).is_some());
        }
        // The order also names what was taken long ago.
        while self.order.len() > 2 * MOST_FRAMES {
            self.order.retain(|key| self.frames.contains_key(key));
        }
    }

    fn get(&mut self, key: FrameKey) -> Option<SampleFrame> {
        let waiting = self.frames.get_mut(&key)?;
        let frame = waiting.pop_front();
        if waiting.is_empty() {
            self.frames.remove(&key);
        }
        let frame = frame?;
        self.held -= 1;
        self.samples -= frame.1.len();
        Some(frame)
    }

    /// Gives a tick the frames that its journal names, as far as they have come.
    fn fill(&mut self, parts: &mut TickParts) {
        let Some((_, taken)) = &parts.journal else {
            return;
        };
        parts.frames.resize_with(taken.len(), || None);
        for (place, taken) in parts.frames.iter_mut().zip(taken) {
            if place.is_none() {
                *place = self.get((taken.source_id, taken.source_epoch, taken.frame_seq));
            }
        }
    }
}
