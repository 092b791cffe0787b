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
    /// True if the reading-age columns are filled too.
    freshness: bool,
    forecasts_w: Vec<f32>,
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
    pub fn of_slots(slots: usize) -> Self {
        let words = slots.div_ceil(WORD).max(1);
        let slots = words * WORD;
        Self {
            words,
            slots: Vec::with_capacity(slots),
            columns: std::array::from_fn(|_| vec![0.0; slots]),
            freshness: false,
            forecasts_w: vec![0.0; slots],
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

    /// Adds the rows of a block that are `ready`. `first` is the slot of its first robot.
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
        self.slots.extend((first..first + LANES).map(|slot| slot as u32));
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.slots.is_empty()
    }

    /// Adds a row. There are at most as many as slots in a tile.
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

    pub(crate) fn infer(&mut self, model: &Model) {
        let rows = self.slots.len();
        let columns = self.columns.each_ref().map(|column| &column[..rows]);
        let predicted = model.predict_columns(columns, &mut self.forecasts_w[..rows]);
        predicted.expect("every column has as many rows as there are forecasts");
    }

    /// Marks the rows that have a feature outside the training range, or NaN.
    pub(crate) fn mark_outside(&mut self, context: &PlatformContext) {
        let outside = &mut self.outside[..self.slots.len()];
        match &context.trained {
            Some(trained) => trained.mark_outside(&self.columns, outside),
            None => outside.fill(false),
        }
    }

    /// The rows from `row` on that are of one block, after [`Batch::infer`] and
    /// [`Batch::mark_outside`], and the row behind them.
    #[inline(always)]
    pub(crate) fn of_block(&self, row: usize) -> Option<(Inferred, usize)> {
        let slots = self.slots.get(row..)?;
        let first = *slots.first()? as usize;
        let (block, whole) = (first / LANES, row..row + LANES);
        if is_block(slots) {
            let mut inferred = Inferred::of_none(block);
            inferred.rows = [true; LANES];
            inferred.forecast_w.copy_from_slice(&self.forecasts_w[whole.clone()]);
            inferred.outside.copy_from_slice(&self.outside[whole.clone()]);
            return Some((inferred, whole.end));
        }
        Some(self.of_part(block, row))
    }

    #[inline(never)]
    fn of_part(&self, block: usize, row: usize) -> (Inferred, usize) {
        let mut inferred = Inferred::of_none(block);
        let mut next = row;
        for slot in self.slots[row..].iter().map(|slot| *slot as usize) {
            if slot / LANES != block {
                break;
            }
            let lane = slot % LANES;
            inferred.rows[lane] = true;
            inferred.forecast_w[lane] = self.forecasts_w[next];
            inferred.outside[lane] = self.outside[next];
            next += 1;
        }
        (inferred, next)
    }

    /// Each slot with its forecast, W, after [`Batch::infer`].
    pub(crate) fn forecasts(&self) -> impl Iterator<Item = (usize, f32)> + '_ {
        self.slots.iter().map(|slot| *slot as usize).zip(self.forecasts_w.iter().copied())
    }
}

/// Results of inference for the robots of a block.
pub(crate) struct Inferred {
    pub block: usize,
    /// Lanes with a row.
    pub rows: Lanes<bool>,
    pub forecast_w: Lanes<f32>,
    /// True if the row is outside the training range.
    pub outside: Lanes<bool>,
}

impl Inferred {
    const fn of_none(block: usize) -> Self {
        Self { block, rows: [false; LANES], forecast_w: [f32::NAN; LANES], outside: [false; LANES] }
    }
}

/// True if the first slots are a whole block's, in their order.
#[inline(always)]
fn is_block(slots: &[u32]) -> bool {
    let Some(slots) = slots.first_chunk::<LANES>() else {
        return false;
    };
    let first = slots[0];
    let mut apart = first % LANES as u32;
    for (lane, slot) in slots.iter().enumerate() {
        apart |= slot ^ (first + lane as u32);
    }
    apart == 0
}
