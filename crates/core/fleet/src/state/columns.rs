//! The state of all robots, in columns indexed by slot.

use crate::alarms::detector::DetectorLanes;
use crate::estimate::energy::EnergyLanes;
use crate::estimate::interval::IntervalLanes;
use crate::estimate::online::OnlineLanes;
use crate::estimate::scores::ScoreLanes;
use crate::estimate::window::WindowLanes;
use crate::ingest::admission::AdmissionState;
use crate::ingest::last_sample::LastLanes;
use crate::ingest::pending::PendingBlock;
use crate::layout::lanes::LANES;
use crate::layout::slots::{self, BLOCKS, Slots};
use crate::ledger::battery::BatteryLanes;
use crate::ledger::departed::Departed;
use crate::ledger::energy::Ledger;
use crate::ledger::energy::LedgerLanes;

/// Bytes of one robot in the columns.
const COLUMNS: usize = size_of::<AdmissionState>()
    + (size_of::<PendingBlock>()
        + size_of::<WindowLanes>()
        + size_of::<LastLanes>()
        + size_of::<IntervalLanes>()
        + size_of::<LedgerLanes>()
        + size_of::<ScoreLanes>()
        + size_of::<DetectorLanes>()
        + size_of::<EnergyLanes>())
    .div_ceil(LANES);

/// A robot takes at most 672 bytes, its account after departure included: the columns, that
/// account, its bit in the slot map, and one and a half entries in each of the two id tables.
const _: () =
    assert!(COLUMNS + size_of::<Ledger>() + Departed::BYTES + 1 + 3 * size_of::<u32>() <= 672);

/// The state of a block of robots.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BlockRef<'a> {
    pub admissions: &'a [AdmissionState; LANES],
    pub lasts: &'a LastLanes,
    pub windows: &'a WindowLanes,
    pub intervals: &'a IntervalLanes,
    pub ledgers: &'a LedgerLanes,
    pub scores: &'a ScoreLanes,
    pub detectors: &'a DetectorLanes,
    pub energy: &'a EnergyLanes,
    /// `None` unless a platform learns online.
    pub online: Option<&'a OnlineLanes>,
    /// `None` unless a platform has a battery.
    pub batteries: Option<&'a BatteryLanes>,
}

/// The columns, for the capacity rounded up to a whole block.
#[derive(Debug)]
pub(crate) struct Columns {
    pub admissions: Vec<AdmissionState>,
    pub pending: Vec<PendingBlock>,
    pub windows: Vec<WindowLanes>,
    pub lasts: Vec<LastLanes>,
    pub intervals: Vec<IntervalLanes>,
    pub ledgers: Vec<LedgerLanes>,
    pub scores: Vec<ScoreLanes>,
    pub detectors: Vec<DetectorLanes>,
    pub energy: Vec<EnergyLanes>,
    /// Empty unless a platform learns online.
    pub online: Vec<OnlineLanes>,
    /// Empty unless a platform has a battery.
    pub batteries: Vec<BatteryLanes>,
    pub slots: Slots,
}

impl Columns {
    /// `learning`: whether a platform learns online; `batteries`: whether one has a battery.
    pub(crate) fn new(
        capacity: usize,
        platforms: usize,
        (learning, batteries): (bool, bool),
    ) -> Self {
        let blocks = capacity.div_ceil(LANES);
        let robots = blocks * LANES;
        Self {
            admissions: vec![AdmissionState::FREE; robots],
            pending: vec![PendingBlock::default(); blocks],
            windows: vec![WindowLanes::default(); blocks],
            lasts: vec![LastLanes::default(); blocks],
            intervals: vec![IntervalLanes::default(); blocks],
            ledgers: vec![LedgerLanes::default(); blocks],
            scores: vec![ScoreLanes::default(); blocks],
            detectors: vec![DetectorLanes::default(); blocks],
            energy: vec![EnergyLanes::default(); blocks],
            online: vec![OnlineLanes::default(); if learning { blocks } else { 0 }],
            batteries: vec![BatteryLanes::default(); if batteries { blocks } else { 0 }],
            slots: Slots::new(capacity, platforms),
        }
    }

    /// State from which the output of a block is computed.
    pub(crate) fn block(&self, block: usize) -> BlockRef<'_> {
        BlockRef {
            admissions: &self.admissions.as_chunks().0[block],
            lasts: &self.lasts[block],
            windows: &self.windows[block],
            intervals: &self.intervals[block],
            ledgers: &self.ledgers[block],
            scores: &self.scores[block],
            detectors: &self.detectors[block],
            energy: &self.energy[block],
            online: self.online.get(block),
            batteries: self.batteries.get(block),
        }
    }

    pub(crate) fn view_mut(&mut self) -> ColumnsMut<'_> {
        ColumnsMut {
            admissions: &mut self.admissions,
            pending: &mut self.pending,
            windows: &mut self.windows,
            lasts: &mut self.lasts,
            intervals: &mut self.intervals,
            ledgers: &mut self.ledgers,
            scores: &mut self.scores,
            detectors: &mut self.detectors,
            energy: &mut self.energy,
            online: &mut self.online,
            batteries: &mut self.batteries,
            words: self.slots.words(),
        }
    }
}

/// Columns of a contiguous range of slots, all of one length, and a bit for each slot in use.
/// Ranges of different shards are disjoint.
#[derive(Debug)]
pub(crate) struct ColumnsMut<'a> {
    pub admissions: &'a mut [AdmissionState],
    pub pending: &'a mut [PendingBlock],
    pub windows: &'a mut [WindowLanes],
    pub lasts: &'a mut [LastLanes],
    pub intervals: &'a mut [IntervalLanes],
    pub ledgers: &'a mut [LedgerLanes],
    pub scores: &'a mut [ScoreLanes],
    pub detectors: &'a mut [DetectorLanes],
    pub energy: &'a mut [EnergyLanes],
    /// Empty unless a platform learns online.
    pub online: &'a mut [OnlineLanes],
    /// Empty unless a platform has a battery.
    pub batteries: &'a mut [BatteryLanes],
    pub words: &'a [u64],
}

impl<'a> ColumnsMut<'a> {
    /// The slots of the first `words` words, and the rest.
    pub(crate) fn split(self, words: usize) -> (Self, Self) {
        let words = words.min(self.words.len());
        let block = (words * BLOCKS).min(self.intervals.len());
        let at = block * LANES;
        let admissions = self.admissions.split_at_mut(at);
        let pending = self.pending.split_at_mut(block);
        let windows = self.windows.split_at_mut(block);
        let lasts = self.lasts.split_at_mut(block);
        let intervals = self.intervals.split_at_mut(block);
        let ledgers = self.ledgers.split_at_mut(block);
        let scores = self.scores.split_at_mut(block);
        let detectors = self.detectors.split_at_mut(block);
        let energy = self.energy.split_at_mut(block);
        let online = self.online.split_at_mut(block.min(self.online.len()));
        let batteries = self.batteries.split_at_mut(block.min(self.batteries.len()));
        let words = self.words.split_at(words);
        (
            Self {
                admissions: admissions.0,
                pending: pending.0,
                windows: windows.0,
                lasts: lasts.0,
                intervals: intervals.0,
                ledgers: ledgers.0,
                scores: scores.0,
                detectors: detectors.0,
                energy: energy.0,
                online: online.0,
                batteries: batteries.0,
                words: words.0,
            },
            Self {
                admissions: admissions.1,
                pending: pending.1,
                windows: windows.1,
                lasts: lasts.1,
                intervals: intervals.1,
                ledgers: ledgers.1,
                scores: scores.1,
                detectors: detectors.1,
                energy: energy.1,
                online: online.1,
                batteries: batteries.1,
                words: words.1,
            },
        )
    }

    /// Reborrows the columns.
    pub(crate) fn reborrow(&mut self) -> ColumnsMut<'_> {
        ColumnsMut {
            admissions: self.admissions,
            pending: self.pending,
            windows: self.windows,
            lasts: self.lasts,
            intervals: self.intervals,
            ledgers: self.ledgers,
            scores: self.scores,
            detectors: self.detectors,
            energy: self.energy,
            online: self.online,
            batteries: self.batteries,
            words: self.words,
        }
    }

    /// As [`Columns::block`].
    #[inline(always)]
    pub(crate) fn block(&self, block: usize) -> BlockRef<'_> {
        BlockRef {
            admissions: &self.admissions.as_chunks().0[block],
            lasts: &self.lasts[block],
            windows: &self.windows[block],
            intervals: &self.intervals[block],
            ledgers: &self.ledgers[block],
            scores: &self.scores[block],
            detectors: &self.detectors[block],
            energy: &self.energy[block],
            online: self.online.get(block),
            batteries: self.batteries.get(block),
        }
    }

    /// Number of robots in these slots.
    pub(crate) fn robots(&self) -> usize {
        slots::count(self.words)
    }
}
