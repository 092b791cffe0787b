//! Batch of rows for a model.

use joulebus_predictor::{FEATURES, FeatureSet, Features, INPUTS, Model};

use crate::estimate::mixture::Blending;
use crate::layout::lanes::{self, LANES, Lanes};
use crate::layout::slots::WORD;
use crate::state::columns::ColumnsMut;
use crate::tick::platform_context::PlatformContext;

/// Default slots per tile: their state, rows and output stay in the core's cache.
const SLOTS: usize = 512;
/// Position of the newest reading in a row.
const LAST: usize = FeatureSet::PowerOnly.first();

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
    /// Forecasts of the linear baseline, if a platform learns online.
    linear_w: Vec<f32>,
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
            linear_w: vec![0.0; slots],
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

    /// Replaces the network's forecasts by the mixtures' of each robot, after [`Batch::infer`].
    /// `open`: open-loop rows, from which nothing is learned.
    pub(crate) fn blend(&mut self, blending: &Blending, columns: &mut ColumnsMut<'_>, open: bool) {
        let rows = self.slots.len();
        if let Some(linear) = &blending.linear {
            let columns = self.columns.each_ref().map(|column| &column[..rows]);
            linear.predict_columns(columns, &mut self.linear_w[..rows]);
        }
        let last_w = &self.columns[LAST];
        for (at, slot) in self.slots.iter().map(|slot| *slot as usize).enumerate() {
            let network_w = self.forecasts_w[at];
            if !network_w.is_finite() {
                continue;
            }
            let window = lanes::get(columns.windows, slot);
            let due = if open {
                window.shown_due()
            } else {
                window.due()
            };
            let blend = &mut columns.blends[slot];
            let linear_w = blending.linear.map_or(f32::NAN, |_| self.linear_w[at]);
            let said_w = [last_w[at], linear_w, network_w];
            let (forecast_w, experts_w) = blend.forecast(blending, said_w, due);
            self.forecasts_w[at] = forecast_w;
            if !open {
                blend.expect(experts_w, due);
            }
        }
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
