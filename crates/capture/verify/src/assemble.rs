//! Assembles the parts of each tick: a capture has them in the order in which the recorder received
//! them.

use std::collections::{BTreeMap, HashMap, HashSet, VecDeque};
use std::hash::{BuildHasher as _, Hash, Hasher, RandomState};

use joulebus_wire::{
    Channel, FrameOrder, SampleHeader, Samples, State, StateHeader, TakenFrame, Ticks,
};

use crate::loss::Loss;
use crate::output::Output;
use crate::tick_id::TickId;
use joulebus_capture_format::{Content as _, Frame, Message, MessageKind};

/// Maximum lead, in ticks, of one service over another in a capture: more than any service buffers.
const MAX_LEAD_TICKS: u64 = 64;
/// Maximum number of ticks that are incomplete at either end of a run or a recording: a worker is
/// killed between two outputs of a tick, and a recorder begins and ends between two messages.
const MAX_CUT_OFF_TICKS: u64 = 2;
/// Number of the last ticks of a run, and of the last frames of samples, whose bits are remembered
/// to recognise copies.
const MAX_REMEMBERED: usize = 8_192;
/// Maximum number of frames of samples waiting for their tick.
const MAX_FRAMES: usize = 8_192;
/// Maximum number of samples in them: 224 MB.
const MAX_SAMPLES: usize = 4_000_000;
/// Maximum number of unfinished runs of the worker. Older ones count as ended.
const MAX_RUNS: usize = 8;
/// Maximum size of a keyframe, bytes: that of a million robots has about 305 MB.
const MAX_KEYFRAME_BYTES: u64 = 512 << 20;

pub(super) type SampleFrame = Frame<Samples>;

/// True if a tick may be cut off by the end of its run, whose last one is `last`.
pub(super) const fn is_among_last(tick: u64, last: u64) -> bool {
    tick.saturating_add(MAX_CUT_OFF_TICKS) > last
}

/// Recorded parts of one tick.
#[derive(Debug, Default)]
pub(super) struct TickParts {
    pub(super) journal: Option<Frame<Ticks>>,
    /// The frames of the journal, in its order. `None` where the capture lacks one, and for a new
    /// normal.
    pub(super) frames: Vec<Option<SampleFrame>>,
    /// Missing frames and their positions. None until the tick is the next one of its run.
    wanted: Option<HashMap<FrameKey, VecDeque<usize>>>,
    /// A frame of the journal of which the capture has several that differ.
    pub(super) ambiguous: Option<FrameKey>,
    /// Kinds of which the capture has several frames that differ.
    pub(super) differing: Vec<MessageKind>,
    /// Frames of what the worker sends, each of another kind.
    outputs: Vec<Message>,
}

/// An event in a worker's run.
#[derive(Debug)]
pub(super) enum Event {
    /// A tick with all its parts. Ticks of a run are in order.
    Tick { worker_epoch: u64, tick: u64, parts: Box<TickParts> },
    /// A complete keyframe, with the header of its first piece.
    Keyframe { header: StateHeader, bytes: Vec<u8> },
    /// A keyframe with a missing piece. `is_cut_off` if its run ended before it was complete.
    Broken { worker_epoch: u64, tick: u64, is_cut_off: bool },
    /// A frame that contradicts an earlier one, or belongs to no tick.
    Contradiction { tick: u64, why: Loss },
}

/// Converts messages to events.
#[derive(Debug)]
pub(super) struct Assembler {
    /// Outputs that a worker sends in a tick.
    outputs: Vec<Output>,
    runs: BTreeMap<u64, WorkerRun>,
    frames: FrameStore,
    /// The newest of each kind, by run, and whether it is complete.
    newest: HashMap<(u64, MessageKind), u64>,
    /// Kinds that the capture has.
    kinds: HashSet<MessageKind>,
    /// The oldest and the newest frame of each run of each source.
    frame_range: HashMap<(u64, u64), (u64, u64)>,
    /// Start of the recording: run and tick.
    first: Option<TickId>,
    ended: bool,
    pieces: Pieces,
    /// The last released ticks of the newest runs.
    released: BTreeMap<u64, Released>,
    hasher: RandomState,
    events: VecDeque<Event>,
}

#[derive(Debug, Default)]
struct Pieces {
    /// The keyframe whose pieces arrive, with its first header.
    open: Option<(StateHeader, Vec<u8>)>,
    /// The last complete one.
    whole: Option<(StateHeader, Vec<u8>)>,
    /// The last one with a missing piece: its further pieces are not counted.
    broken: Option<TickId>,
    has_begun: bool,
}

/// Hashes of the frames of released ticks, to recognise copies.
#[derive(Debug, Default)]
struct Released {
    last: u64,
    ticks: VecDeque<(u64, Vec<(MessageKind, u64)>)>,
}

/// Waiting parts of one run of the worker.
#[derive(Debug, Default)]
struct WorkerRun {
    ticks: BTreeMap<u64, TickParts>,
    newest: u64,
}

/// Frames not taken by a tick so far, each with its number, and their order of arrival.
#[derive(Debug, Default)]
struct FrameStore {
    frames: HashMap<FrameKey, VecDeque<(u64, SampleFrame)>>,
    /// Numbers of frames, including some taken long ago.
    order: VecDeque<(u64, FrameKey)>,
    next: u64,
    held: usize,
    samples: usize,
    untaken: u64,
    /// The last frames that ticks took, with their hash and the tick, and their order.
    taken: HashMap<FrameKey, (u64, u64)>,
    taken_order: VecDeque<FrameKey>,
}

/// Source, its run, and the number of a frame in it.
pub(super) type FrameKey = (u64, u64, u64);

impl Assembler {
    pub(super) fn new(outputs: Vec<Output>) -> Self {
        Self {
            outputs,
            runs: BTreeMap::new(),
            frames: FrameStore::default(),
            newest: HashMap::new(),
            kinds: HashSet::new(),
            frame_range: HashMap::new(),
            first: None,
            ended: false,
            pieces: Pieces::default(),
            released: BTreeMap::new(),
            hasher: RandomState::new(),
            events: VecDeque::new(),
        }
    }

    /// Outputs that a worker sends in a tick.
    pub(super) fn outputs(&self) -> &[Output] {
        &self.outputs
    }

    /// Also assembles frames of another channel.
    pub(super) fn add_output(&mut self, output: Output) {
        self.outputs.push(output);
    }

    /// Takes a message. Other kinds are ignored.
    pub(super) fn push(&mut self, mut message: Message) {
        if let Some(frame) = message.frame_mut::<Samples>() {
            self.put(std::mem::take(frame));
        } else if let Some(piece) = message.frame::<State>() {
            self.add_piece(piece.header, &piece.rows);
        } else if let (Some(kind), Some(order)) = (message.kind(), message.order())
            && self.is_of_tick(kind)
        {
            if self.is_released(order, kind, &message) {
                return;
            }
            let parts = self.parts(order, kind);
            match message.into_frame::<Ticks>() {
                Ok(journal) if parts.journal.is_none() => {
                    parts.journal = Some(journal);
                    // Positions follow the journal: `fill` finds the frames anew.
                    parts.wanted = None;
                }
                Ok(journal) if parts.journal.as_ref() == Some(&journal) => return,
                Ok(_) => parts.differing.push(kind),
                Err(output) => match parts.output(kind) {
                    None => parts.outputs.push(output),
                    Some(before) if *before == output => return,
                    Some(_) => parts.differing.push(kind),
                },
            }
        } else {
            return;
        }
        self.release(false);
    }

    fn is_of_tick(&self, kind: MessageKind) -> bool {
        let mut outputs = self.outputs.iter();
        kind == MessageKind::of::<Ticks>() || outputs.any(|output| output.kind == kind)
    }

    /// True if the tick of the frame is released: then the frame is a copy, or contradicts others.
    fn is_released(&mut self, order: FrameOrder, kind: MessageKind, message: &Message) -> bool {
        let Some(released) = self.released.get(&order.run).filter(|run| order.number <= run.last)
        else {
            return false;
        };
        let found = released.ticks.binary_search_by_key(&order.number, |(tick, _)| *tick);
        let frames = found.ok().map(|place| &released.ticks[place].1);
        let before = frames.and_then(|frames| frames.iter().find(|(of, _)| *of == kind));
        let why = match before {
            Some((_, hash)) if *hash == self.hasher.hash_one(message) => return true,
            Some(_) => Loss::Differing(kind.name()),
            None => Loss::Stray(kind.name()),
        };
        self.events.push_back(Event::Contradiction { tick: order.number, why });
        true
    }

    /// Ends the input: releases the waiting parts.
    pub(super) fn finish(&mut self) {
        if let Some((first, _)) = self.pieces.open.take() {
            let (worker_epoch, tick) = (first.worker_epoch, first.tick);
            self.events.push_back(Event::Broken { worker_epoch, tick, is_cut_off: true });
        }
        self.ended = true;
        self.release(true);
    }

    /// The next event, if one is complete.
    pub(super) fn next_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Frames of samples that no tick took, as far as known.
    pub(super) fn untaken_frames(&self) -> u64 {
        let held = self.frames.frames.keys();
        self.frames.untaken + held.filter(|key| !self.frames.taken.contains_key(key)).count() as u64
    }

    /// Cause that a message of `kind` is missing: lost, or never sent because the run ended.
    pub(super) fn lack(&self, TickId { run, tick }: TickId, kind: MessageKind, lost: Loss) -> Loss {
        let newest = self.newest.get(&(run, kind)).copied().unwrap_or_default();
        let is_cut_off = self.kinds.contains(&kind) && self.is_over(run, tick) && tick > newest;
        if is_cut_off { Loss::End } else { lost }
    }

    /// The newest tick of a run of which the capture has anything.
    pub(super) fn last_tick(&self, run: u64) -> u64 {
        let kinds = self.kinds.iter().map(|kind| self.newest.get(&(run, *kind)));
        kinds.flatten().copied().max().unwrap_or_default()
    }

    /// Same as [`Assembler::lack`], for a frame of samples.
    pub(super) fn lack_of_frame(&self, TickId { run, tick }: TickId, taken: &TakenFrame) -> Loss {
        let (source_id, frame_seq) = (taken.source_id, taken.frame_seq);
        let range = self.frame_range.get(&(source_id, taken.source_epoch));
        if self.is_over(run, tick) && range.is_none_or(|(_, newest)| frame_seq > *newest) {
            Loss::End
        } else if self.is_young(run, tick) && range.is_none_or(|(oldest, _)| frame_seq < *oldest) {
            Loss::Beginning
        } else {
            Loss::Samples { source_id, frame_seq }
        }
    }

    /// True if the run has ended, and `tick` is among its last.
    fn is_over(&self, run: u64, tick: u64) -> bool {
        let is_newest = self.runs.keys().next_back().is_none_or(|newest| *newest <= run);
        (self.ended || !is_newest) && is_among_last(tick, self.last_tick(run))
    }

    /// True if `tick` is among the first of the recording.
    fn is_young(&self, run: u64, tick: u64) -> bool {
        self.first.is_some_and(|first| {
            run == first.run && tick < first.tick.saturating_add(MAX_CUT_OFF_TICKS)
        })
    }

    fn parts(&mut self, order: FrameOrder, kind: MessageKind) -> &mut TickParts {
        let (worker_epoch, tick) = (order.run, order.number);
        let newest = self.newest.entry((worker_epoch, kind)).or_default();
        *newest = tick.max(*newest);
        self.kinds.insert(kind);
        // A new reader first receives the newest frame of some channels, which may be old.
        if kind == MessageKind::of::<Ticks>() {
            self.first.get_or_insert(TickId::new(worker_epoch, tick));
        }
        let run = self.runs.entry(worker_epoch).or_default();
        run.newest = run.newest.max(tick);
        run.ticks.entry(tick).or_default()
    }

    fn put(&mut self, frame: SampleFrame) {
        let header = &frame.header;
        let key = (header.source_id, header.source_epoch);
        let seq = header.frame_seq;
        let range = self.frame_range.entry(key).or_insert((seq, seq));
        *range = (seq.min(range.0), seq.max(range.1));
        let key = key_of(header);
        // Only the first tick of a run waits for single frames. Later ones look into the store once
        // they are first.
        let mut next = self.runs.values_mut().filter_map(|run| run.ticks.first_entry());
        let place =
            next.find_map(|mut tick| tick.get_mut().place_of(key).map(|place| (tick, place)));
        match place {
            Some((tick, place)) => tick.into_mut().frames[place] = Some(frame),
            None => {
                let (source_id, _, frame_seq) = key;
                if let Some((hash, tick)) = self.frames.taken.get(&key).copied()
                    && self.hasher.hash_one(Bits(&frame)) != hash
                {
                    let why = Loss::Ambiguous { source_id, frame_seq };
                    self.events.push_back(Event::Contradiction { tick, why });
                }
                self.frames.put(frame);
            }
        }
    }

    fn add_piece(&mut self, header: StateHeader, bytes: &[u8]) {
        let pieces = &mut self.pieces;
        let has_begun = std::mem::replace(&mut pieces.has_begun, true);
        let id = TickId::new(header.worker_epoch, header.tick);
        let of = |first: &StateHeader| TickId::new(first.worker_epoch, first.tick) == id;
        let (offset, total) = (header.offset, header.total_bytes);
        let is_copy = |sofar: &[u8]| {
            let rest = usize::try_from(offset).ok().and_then(|at| sofar.get(at..));
            rest.is_some_and(|rest| !rest.is_empty() && rest.starts_with(bytes))
        };
        let whole = pieces.whole.as_ref().filter(|(first, _)| of(first));
        let open = pieces.open.as_ref().filter(|(first, _)| of(first));
        let belongs = |first: &StateHeader| {
            (first.total_bytes, first.before_hash) == (total, header.before_hash)
        };
        if pieces.broken == Some(id)
            || whole.or(open).is_some_and(|(first, sofar)| belongs(first) && is_copy(sofar))
        {
            return;
        }
        let follows = open.is_some_and(|(first, sofar)| {
            belongs(first) && sofar.len() as u64 == offset && bytes.len() as u64 <= total - offset
        });
        let is_first = whole.is_none()
            && open.is_none()
            && offset == 0
            && total <= MAX_KEYFRAME_BYTES
            && bytes.len() as u64 <= total;
        if follows {
            pieces.open.iter_mut().for_each(|(_, sofar)| sofar.extend_from_slice(bytes));
        } else {
            // The one before stays incomplete.
            if let Some((first, _)) = pieces.open.take() {
                let (worker_epoch, tick) = (first.worker_epoch, first.tick);
                let is_cut_off = worker_epoch < header.worker_epoch;
                self.events.push_back(Event::Broken { worker_epoch, tick, is_cut_off });
                if TickId::new(worker_epoch, tick) == id {
                    pieces.broken = Some(id);
                    return;
                }
            }
            if !is_first {
                pieces.broken = Some(id);
                // A recording may begin with the last pieces of a keyframe.
                if has_begun || offset == 0 {
                    let TickId { run: worker_epoch, tick } = id;
                    self.events.push_back(Event::Broken { worker_epoch, tick, is_cut_off: false });
                }
                return;
            }
            pieces.open = Some((header, bytes.to_vec()));
        }
        let is_whole =
            |(first, sofar): &mut (StateHeader, Vec<u8>)| sofar.len() as u64 == first.total_bytes;
        if let Some((first, whole)) = pieces.open.take_if(is_whole) {
            self.events.push_back(Event::Keyframe { header: first, bytes: whole.clone() });
            pieces.whole = Some((first, whole));
        }
    }

    /// Releases the ticks that are complete, and those that never will be.
    fn release(&mut self, all: bool) {
        let newest_run = self.runs.keys().next_back().copied().unwrap_or_default();
        let newest_tick = self.runs.get(&newest_run).map_or(0, |run| run.newest);
        let oldest_run = self.runs.keys().rev().nth(MAX_RUNS - 1).copied();
        let oldest_run = oldest_run.unwrap_or_default();
        for (worker_epoch, run) in &mut self.runs {
            // A run that others have long followed has ended.
            let over = all
                || (*worker_epoch < newest_run && newest_tick > MAX_LEAD_TICKS)
                || *worker_epoch < oldest_run;
            while let Some(mut head) = run.ticks.first_entry() {
                // Not earlier: the tick before may list the same frame, and takes the older one.
                self.frames.fill(head.get_mut());
                let (tick, parts) = (*head.key(), head.get());
                // A part that lags further behind the run's newest tick was lost.
                if !parts.is_complete(&self.outputs)
                    && !over
                    && run.newest < tick.saturating_add(MAX_LEAD_TICKS)
                {
                    break;
                }
                let mut parts = Box::new(head.remove());
                parts.ambiguous = self.frames.ambiguous(&parts.frames);
                for frame in parts.frames.iter().flatten() {
                    let hash = self.hasher.hash_one(Bits(frame));
                    self.frames.remember(key_of(&frame.header), hash, tick);
                }
                let released = self.released.entry(*worker_epoch).or_default();
                released.remember(tick, parts.hashes(&self.hasher));
                self.events.push_back(Event::Tick { worker_epoch: *worker_epoch, tick, parts });
            }
            // The ticks of a run come before those of the next one.
            if !run.ticks.is_empty() {
                break;
            }
        }
        while self.released.len() > MAX_RUNS {
            self.released.pop_first();
        }
        // The newest run stays, even without ticks: it shows which runs have ended.
        self.runs.retain(|worker_epoch, run| *worker_epoch == newest_run || !run.ticks.is_empty());
    }
}

impl TickParts {
    fn is_complete(&self, outputs: &[Output]) -> bool {
        let Some(journal) = &self.journal else {
            return false;
        };
        let mut outputs = outputs.iter();
        self.wanted.as_ref().is_some_and(HashMap::is_empty)
            && outputs.all(|output| {
                !output.kind.is_sent_in(&journal.header) || self.output(output.kind).is_some()
            })
    }

    /// The frame of this kind.
    pub(super) fn output(&self, kind: MessageKind) -> Option<&Message> {
        self.outputs.iter().find(|frame| frame.kind() == Some(kind))
    }

    /// Hashes of the journal and the outputs.
    fn hashes(&self, hasher: &RandomState) -> Vec<(MessageKind, u64)> {
        let journal = self.journal.as_ref();
        let journal =
            journal.map(|journal| (MessageKind::of::<Ticks>(), hasher.hash_one(Bits(journal))));
        let outputs = self.outputs.iter();
        let outputs = outputs.filter_map(|frame| Some((frame.kind()?, hasher.hash_one(frame))));
        journal.into_iter().chain(outputs).collect()
    }

    /// Position of a frame that the tick is waiting for.
    fn place_of(&mut self, key: FrameKey) -> Option<usize> {
        let wanted = self.wanted.as_mut()?;
        let places = wanted.get_mut(&key)?;
        let place = places.pop_front();
        if places.is_empty() {
            wanted.remove(&key);
        }
        place
    }

    /// Approximate memory of the parts, bytes.
    pub(super) fn bytes(&self) -> usize {
        let frames = self.frames.iter().flatten();
        let samples = frames.map(|frame| size_of_val(frame.rows.as_slice()));
        let outputs = self.outputs.iter().map(Message::memory);
        size_of::<Self>() + samples.chain(outputs).sum::<usize>()
    }
}

/// A frame that is hashed as its message.
struct Bits<'a, C: Channel>(&'a Frame<C>);

impl<C: Channel> Hash for Bits<'_, C> {
    fn hash<H: Hasher>(&self, state: &mut H) {
        MessageKind::of::<C>().hash(state);
        self.0.hash_bits(state);
    }
}

impl Released {
    fn remember(&mut self, tick: u64, frames: Vec<(MessageKind, u64)>) {
        self.last = tick;
        self.ticks.push_back((tick, frames));
        if self.ticks.len() > MAX_REMEMBERED {
            self.ticks.pop_front();
        }
    }
}

const fn key_of(header: &SampleHeader) -> FrameKey {
    (header.source_id, header.source_epoch, header.frame_seq)
}

impl FrameStore {
    fn put(&mut self, frame: SampleFrame) {
        let key = key_of(&frame.header);
        self.held += 1;
        self.samples += frame.rows.len();
        self.order.push_back((self.next, key));
        let waiting = self.frames.entry(key).or_default();
        waiting.push_back((self.next, frame));
        self.next += 1;
        while self.held > MAX_FRAMES || (self.samples > MAX_SAMPLES && self.held > 1) {
            let Some((number, oldest)) = self.order.pop_front() else {
                return;
            };
            // A tick may have taken it: the order keeps entries of taken frames.
            if self.holds(number, oldest) {
                // Copies of one that a tick took do not count.
                let is_other = !self.taken.contains_key(&oldest);
                self.untaken += u64::from(self.get(oldest).is_some() && is_other);
            }
        }
        // Taken frames are removed from the order once they are more than half of it.
        if self.order.len() > 2 * self.held + MAX_FRAMES {
            let mut order = std::mem::take(&mut self.order);
            order.retain(|(number, key)| self.holds(*number, *key));
            self.order = order;
        }
    }

    /// True if the frame of that number has not been taken: those of a key are taken in order.
    fn holds(&self, number: u64, key: FrameKey) -> bool {
        let waiting = self.frames.get(&key).and_then(VecDeque::front);
        waiting.is_some_and(|(oldest, _)| *oldest <= number)
    }

    fn get(&mut self, key: FrameKey) -> Option<SampleFrame> {
        let waiting = self.frames.get_mut(&key)?;
        let frame = waiting.pop_front();
        if waiting.is_empty() {
            self.frames.remove(&key);
        }
        let (_, frame) = frame?;
        self.held -= 1;
        self.samples -= frame.rows.len();
        Some(frame)
    }

    /// Remembers a frame that `tick` took.
    fn remember(&mut self, key: FrameKey, hash: u64, tick: u64) {
        if self.taken.insert(key, (hash, tick)).is_none() {
            self.taken_order.push_back(key);
        }
        if self.taken_order.len() > MAX_REMEMBERED
            && let Some(oldest) = self.taken_order.pop_front()
        {
            self.taken.remove(&oldest);
        }
    }

    /// The first of a tick's `frames` with the source, run and number of another frame that
    /// differs: one of them is false, and nothing shows which of them the worker took. The others
    /// are not taken any more.
    fn ambiguous(&mut self, frames: &[Option<SampleFrame>]) -> Option<FrameKey> {
        let mut first = None;
        let mut seen: HashMap<FrameKey, &SampleFrame> = HashMap::new();
        for frame in frames.iter().flatten() {
            let key = key_of(&frame.header);
            let waiting = self.frames.get(&key).into_iter().flatten();
            let mut others = waiting.map(|(_, other)| other).chain(seen.insert(key, frame));
            if others.any(|other| *frame != *other) {
                first.get_or_insert(key);
                while self.get(key).is_some() {
                    self.untaken += 1;
                }
            }
        }
        first
    }

    /// Adds the available frames in a tick's journal, once. Frames that arrive later are added one
    /// by one.
    fn fill(&mut self, parts: &mut TickParts) {
        let (None, Some(journal)) = (&parts.wanted, &parts.journal) else {
            return;
        };
        let taken = &journal.rows;
        let mut wanted: HashMap<FrameKey, VecDeque<usize>> = HashMap::new();
        parts.frames.resize_with(taken.len(), || None);
        for (place, taken) in taken.iter().enumerate() {
            let frame = &mut parts.frames[place];
            if frame.is_none() && taken.is_frame() {
                let key = (taken.source_id, taken.source_epoch, taken.frame_seq);
                *frame = self.get(key);
                if frame.is_none() {
                    wanted.entry(key).or_default().push_back(place);
                }
            }
        }
        parts.wanted = Some(wanted);
    }
}

#[cfg(test)]
mod tests {
    use joulebus_wire::{
        BudgetHeader, Budgets, DiagnosticHeader, Diagnostics, ForecastHeader, Forecasts, TickHeader,
    };

    use super::*;

    fn frame(frame_seq: u64) -> Message {
        let header = SampleHeader { frame_seq, ..SampleHeader::default() };
        Message::of::<Samples>(header, Vec::new())
    }

    fn journal(worker_epoch: u64, tick: u64, frames: impl Iterator<Item = u64>) -> Message {
        let header = TickHeader { worker_epoch, tick, ..TickHeader::default() };
        let taken = frames.map(|frame_seq| TakenFrame {
            source_id: 0,
            source_epoch: 0,
            frame_seq,
            taken_ns: 0,
            samples: 0,
            truncated: 0,
        });
        Message::of::<Ticks>(header, taken.collect())
    }

    fn outputs(worker_epoch: u64, tick: u64) -> [Message; 3] {
        let forecasts = ForecastHeader { worker_epoch, tick, ..ForecastHeader::default() };
        let diagnostics = DiagnosticHeader { worker_epoch, tick, ..DiagnosticHeader::default() };
        let budgets = BudgetHeader { worker_epoch, tick, ..BudgetHeader::default() };
        [
            Message::of::<Forecasts>(forecasts, Vec::new()),
            Message::of::<Diagnostics>(diagnostics, Vec::new()),
            Message::of::<Budgets>(budgets, Vec::new()),
        ]
    }

    /// The released ticks, each with whether all its frames are present.
    fn ticks(assembler: &mut Assembler) -> Vec<(u64, u64, bool)> {
        let mut ticks = Vec::new();
        while let Some(event) = assembler.next_event() {
            if let Event::Tick { worker_epoch, tick, parts } = event {
                let whole = parts.frames.iter().all(Option::is_some);
                ticks.push((worker_epoch, tick, whole));
            }
        }
        ticks
    }

    #[test]
    fn a_tick_gets_its_frames_at_any_order_of_arrival_and_each_frame_once() {
        // Two ticks list the same frame, which was received twice.
        let (first, second) = (journal(1, 1, [5, 6].into_iter()), journal(1, 2, [6].into_iter()));
        let orders: [&[usize]; 4] =
            [&[0, 1, 2, 3, 4], &[3, 4, 0, 1, 2], &[0, 3, 1, 4, 2], &[4, 2, 3, 1, 0]];
        let messages = [first, frame(5), frame(6), frame(6), second];
        for order in orders {
            let mut assembler = Assembler::new(Output::all());
            for at in order {
                assembler.push(messages[*at].clone());
            }
            for message in outputs(1, 1).into_iter().chain(outputs(1, 2)) {
                assembler.push(message);
            }
            assert_eq!(ticks(&mut assembler), [(1, 1, true), (1, 2, true)], "{order:?}");
            assembler.finish();
            assert_eq!(assembler.untaken_frames(), 0, "{order:?}");
        }
    }

    /// Number of messages in a small file. The cost of each must not grow with their number,
    /// otherwise these tests take hours.
    const MANY: u64 = 200_000;

    #[test]
    fn a_tick_that_lacks_many_frames_does_not_slow_later_messages() {
        let mut assembler = Assembler::new(Output::all());
        assembler.push(journal(1, 1, 0..MANY));
        for seq in 0..MANY {
            assembler.push(frame(MANY + seq));
        }
        for seq in 0..MANY {
            assembler.push(frame(seq));
        }
        outputs(1, 1).into_iter().for_each(|message| assembler.push(message));
        assert_eq!(ticks(&mut assembler), [(1, 1, true)]);
    }

    #[test]
    fn the_number_of_unfinished_runs_is_bounded() {
        let mut assembler = Assembler::new(Output::all());
        let mut found = 0;
        for run in 1..=MANY {
            assembler.push(journal(run, 1, [7].into_iter()));
            found += ticks(&mut assembler).len();
            assert!(assembler.runs.len() <= MAX_RUNS);
        }
        assert_eq!(found as u64, MANY - MAX_RUNS as u64);
    }

    #[test]
    fn a_frame_received_and_taken_repeatedly_leaves_no_entries() {
        let mut store = FrameStore::default();
        let key = (0, 0, 7);
        for _ in 0..MANY {
            store.put(frame(7).into_frame().unwrap());
            assert!(store.get(key).is_some());
            assert!(store.order.len() <= 2 * MAX_FRAMES);
        }
        assert_eq!((store.held, store.untaken), (0, 0));
    }
}
