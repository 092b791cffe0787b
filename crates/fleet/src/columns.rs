//! The state of all robots, in columns indexed by slot.

use crate::departed::Departed;
use crate::detector::Detector;
use crate::interval::Interval;
use crate::kind::Kind;
use crate::mixture::Blend;
use crate::report::Seen;
use crate::robot::{Gate, Last, News};
use crate::slots::{self, Slots, WORD};
use crate::window::Window;
use crate::{Ledger, Scores};

/// Bytes of one robot in the columns.
const COLUMNS: usize = size_of::<Gate>()
    + size_of::<News>()
    + size_of::<Window>()
    + size_of::<Last>()
    + size_of::<Interval>()
    + size_of::<Ledger>()
    + size_of::<Scores>()
    + size_of::<Detector>();

/// A robot takes at most 512 bytes, the account of one that has left included: the columns, that
/// account, its bit among the slots, and one and a half entries in each of the two tables of ids.
const _: () =
    assert!(COLUMNS + size_of::<Ledger>() + Departed::BYTES + 1 + 3 * size_of::<u32>() <= 512);

/// The columns, with room for the capacity.
#[derive(Debug)]
pub(crate) struct Columns {
    pub gates: Vec<Gate>,
    pub news: Vec<News>,
    pub windows: Vec<Window>,
    pub lasts: Vec<Last>,
    pub intervals: Vec<Interval>,
    pub ledgers: Vec<Ledger>,
    pub scores: Vec<Scores>,
    pub detectors: Vec<Detector>,
    /// Empty unless a platform learns online.
    pub blends: Vec<Blend>,
    pub slots: Slots,
}

impl Columns {
    pub(crate) fn new(capacity: usize, kinds: &[Kind]) -> Self {
        let learning = kinds.iter().any(|kind| kind.blending.is_some());
        Self {
            gates: vec![Gate::FREE; capacity],
            news: vec![News::None; capacity],
            windows: vec![Window::EMPTY; capacity],
            lasts: vec![Last::NONE; capacity],
            intervals: vec![Interval::new(0.0, 0.0, 0.0, 0.0); capacity],
            ledgers: vec![Ledger::default(); capacity],
            scores: vec![Scores::default(); capacity],
            detectors: vec![Detector::new(); capacity],
            blends: vec![Blend::NONE; if learning { capacity } else { 0 }],
            slots: Slots::new(capacity),
        }
    }

    #[inline(always)]
    pub(crate) fn seen(&self, slot: usize) -> Seen<'_> {
        Seen {
            gate: &self.gates[slot],
            last: &self.lasts[slot],
            window: &self.windows[slot],
            interval: &self.intervals[slot],
            ledger: &self.ledgers[slot],
            scores: &self.scores[slot],
            detector: &self.detectors[slot],
        }
    }

    pub(crate) fn part(&mut self) -> Part<'_> {
        Part {
            gates: &mut self.gates,
            news: &mut self.news,
            windows: &mut self.windows,
            lasts: &mut self.lasts,
            intervals: &mut self.intervals,
            ledgers: &mut self.ledgers,
            scores: &mut self.scores,
            detectors: &mut self.detectors,
            blends: &mut self.blends,
            words: self.slots.words(),
        }
    }
}

/// The columns of some slots that follow each other; all of one length, and a bit for each that is
/// in use. Shares of different slots are disjoint.
#[derive(Debug)]
pub(crate) struct Part<'a> {
    pub gates: &'a mut [Gate],
    pub news: &'a mut [News],
    pub windows: &'a mut [Window],
    pub lasts: &'a mut [Last],
    pub intervals: &'a mut [Interval],
    pub ledgers: &'a mut [Ledger],
    pub scores: &'a mut [Scores],
    pub detectors: &'a mut [Detector],
    /// Empty unless a platform learns online.
    pub blends: &'a mut [Blend],
    pub words: &'a [u64],
}

impl<'a> Part<'a> {
    /// The slots of the first `words` words, and the rest.
    pub(crate) fn split(self, words: usize) -> (Self, Self) {
        let words = words.min(self.words.len());
        let at = (words * WORD).min(self.gates.len());
        let gates = self.gates.split_at_mut(at);
        let news = self.news.split_at_mut(at);
        let windows = self.windows.split_at_mut(at);
        let lasts = self.lasts.split_at_mut(at);
        let intervals = self.intervals.split_at_mut(at);
        let ledgers = self.ledgers.split_at_mut(at);
        let scores = self.scores.split_at_mut(at);
        let detectors = self.detectors.split_at_mut(at);
        let blends = self.blends.split_at_mut(at.min(self.blends.len()));
        let words = self.words.split_at(words);
        (
            Self {
                gates: gates.0,
                news: news.0,
                windows: windows.0,
                lasts: lasts.0,
                intervals: intervals.0,
                ledgers: ledgers.0,
                scores: scores.0,
                detectors: detectors.0,
                blends: blends.0,
                words: words.0,
            },
            Self {
                gates: gates.1,
                news: news.1,
                windows: windows.1,
                lasts: lasts.1,
                intervals: intervals.1,
                ledgers: ledgers.1,
                scores: scores.1,
                detectors: detectors.1,
                blends: blends.1,
                words: words.1,
            },
        )
    }

    /// The same columns, for a while.
    pub(crate) fn reborrow(&mut self) -> Part<'_> {
        Part {
            gates: self.gates,
            news: self.news,
            windows: self.windows,
            lasts: self.lasts,
            intervals: self.intervals,
            ledgers: self.ledgers,
            scores: self.scores,
            detectors: self.detectors,
            blends: self.blends,
            words: self.words,
        }
    }

    #[inline(always)]
    pub(crate) fn seen(&self, slot: usize) -> Seen<'_> {
        Seen {
            gate: &self.gates[slot],
            last: &self.lasts[slot],
            window: &self.windows[slot],
            interval: &self.intervals[slot],
            ledger: &self.ledgers[slot],
            scores: &self.scores[slot],
            detector: &self.detectors[slot],
        }
    }

    /// Robots in these slots.
    pub(crate) fn robots(&self) -> usize {
        slots::count(self.words)
    }
}
