//! Batch of rows for a model.

use joulebus_predictor::{FEATURES, Features, INPUTS, Model};

use crate::layout::lanes::{self, LANES, Lanes};
use crate::layout::slots::WORD;
use crate::tick::platform_context::PlatformContext;

/// Default slots per tile: their state, rows and output stay in the core's cache.
const SLOTS: usize = 512;

/// Memory for the rows of one tile, for [`crate::Shard`]: one per thread.
#[derive(Debug, Clone)]
pub struct Batch {
    /// Words of slots in a tile.
    pub(crate) words: usize,
    slots: Vec<u32>,
    columns: [Vec<f32>; INPUTS],
    /// Whether the reading-age columns are filled too.
    freshness: bool,
    forecasts_w: Vec<f32>,
    /// By block: lanes that the network has a forecast for, a bit each.
    forecast_lanes: Vec<u16>,
    outside: Vec<bool>,
    /// Slots whose waiting sample follows a gap.
    pub(crate) gaps: Vec<u32>,
    /// Slots whose next sample is overdue.
    pub(crate) overdue: Vec<u32>,
}

impl Default for Batch {
    fn default() -> Self {
        Self::of_slots(SLOTS)
    }
}

impl Batch {
    /// For tiles of this many slots, rounded up to a multiple of 64, which does not affect the bits
    /// of any output.
    #[must_use]
    pub fn of_slots(slots: usize) -> Self {
        let words = slots.div_ceil(WORD).max(1);
        let slots = words * WORD;
        Self {
            words,
            slots: Vec::with_capacity(slots),
            columns: std::array::from_fn(|_| vec![0.0; slots]),
            freshness: false,
            forecasts_w: vec![0.0; slots],
            forecast_lanes: vec![0; slots / LANES],
            outside: vec![false; slots],
            gaps: Vec::with_capacity(slots),
            overdue: Vec::with_capacity(slots),
        }
    }

    pub(crate) fn clear(&mut self) {
        self.slots.clear();
    }

    /// Empties the batch, for rows of this platform.
    pub(crate) fn begin(&mut self, context: &PlatformContext) {
        self.clear();
        self.gaps.clear();
        self.overdue.clear();
        self.freshness = context.required.freshness;
    }

    /// Adds the rows of a block that are `ready`; `first` is the slot of its first robot.
    #[inline(always)]
    pub(crate) fn push_block(
        &mut self,
        first: usize,
        ready: &Lanes<bool>,
        rows: &[Lanes<f32>; INPUTS],
    ) {
        if lanes::any(&ready.map(|ready| !ready)) {
            for lane in (0..LANES).filter(|lane| ready[*lane]) {
                self.push(first + lane, &rows.map(|values| values[lane]));
            }
            return;
        }
        let at = self.slots.len();
        let features = if self.freshness { INPUTS } else { FEATURES };
        for (column, values) in self.columns.iter_mut().zip(rows).take(features) {
            column[at..at + LANES].copy_from_slice(values);
        }
        self.slots
            .extend((first..first + LANES).map(|slot| slot as u32));
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.slots.is_empty()
    }

    /// Adds a row; there are at most as many as slots in a tile.
    #[inline(always)]
    pub(crate) fn push(&mut self, slot: usize, row: &Features) {
        let at = self.slots.len();
        let (paper, more) = self.columns.split_at_mut(FEATURES);
        for (column, value) in paper.iter_mut().zip(row) {
            column[at] = *value;
        }
        if self.freshness {
            for (column, value) in more.iter_mut().zip(&row[FEATURES..]) {
                column[at] = *value;
            }
        }
        self.slots.push(slot as u32);
    }

    /// Infers the rows.
    pub(crate) fn infer(&mut self, model: &Model) {
        let rows = self.slots.len();
        let columns = self.columns.each_ref().map(|column| &column[..rows]);
        model.predict_columns(columns, &mut self.forecasts_w[..rows]);
    }

    /// By block, the lanes with a forecast that is finite, after [`Batch::infer`].
    pub(crate) fn forecast_lanes(&mut self) -> &[u16] {
        self.forecast_lanes.fill(0);
        for (slot, forecast_w) in self.slots.iter().zip(&self.forecasts_w) {
            let (block, lane) = (*slot as usize / LANES, *slot as usize % LANES);
            self.forecast_lanes[block] |= u16::from(forecast_w.is_finite()) << lane;
        }
        &self.forecast_lanes
    }

    /// Marks the rows that have a feature outside the training range, or NaN.
    pub(crate) fn mark_outside(&mut self, context: &PlatformContext) {
        let outside = &mut self.outside[..self.slots.len()];
        match &context.trained {
            Some(trained) => trained.mark_outside(&self.columns, outside),
            None => outside.fill(false),
        }
    }

    /// Each slot with its mark, after [`Batch::mark_outside`].
    pub(crate) fn outside(&self) -> impl Iterator<Item = (usize, bool)> + '_ {
        self.slots
            .iter()
            .map(|slot| *slot as usize)
            .zip(self.outside.iter().copied())
    }

    /// Each slot with its forecast, W, after [`Batch::infer`].
    pub(crate) fn forecasts(&self) -> impl Iterator<Item = (usize, f32)> + '_ {
        self.slots
            .iter()
            .map(|slot| *slot as usize)
            .zip(self.forecasts_w.iter().copied())
    }
}
