//! Output of the tick in the layout of shared memory: arithmetic is done a block of robots at a
//! time, then each robot is stored to its place.

pub(crate) mod budgets;
pub(crate) mod diagnostics;
mod flag;
pub(crate) mod forecasts;

use std::slice;

use joulebus_predictor::{SimdTask, prefetch};
use joulebus_wire::{Budget, Diagnostic, Forecast};

use crate::layout::lanes::{AHEAD, LANES};
use crate::layout::slots;
use crate::state::columns::ColumnsMut;
use crate::tick::context::TickContext;
use crate::tick::write::budgets::Budgets;
use crate::tick::write::diagnostics::Diagnostics;
use crate::tick::write::forecasts::Forecasts;

/// Prefetches the places of the next robots.
#[inline(always)]
fn prefetch_ahead<T>(places: &[T]) {
    const FROM: usize = AHEAD * LANES;
    if let Some(places) = places.get(FROM..FROM + LANES) {
        prefetch(places);
    }
}

/// Writes the forecasts of a tile.
pub(crate) struct WriteForecasts<'a, 'b, 'c> {
    pub tick: &'a TickContext,
    pub columns: &'a ColumnsMut<'b>,
    pub places: &'a mut slice::IterMut<'c, Forecast>,
}

impl SimdTask for WriteForecasts<'_, '_, '_> {
    #[inline(always)]
    fn run(self) {
        let (tick, columns) = (self.tick, self.columns);
        for (block, lanes) in slots::blocks(columns.words) {
            prefetch_ahead(self.places.as_slice());
            let forecasts = Forecasts::of(columns.block(block));
            for (lane, place) in slots::bits(lanes).zip(self.places.by_ref()) {
                *place = forecasts.get(tick, lane);
            }
        }
    }
}

/// Writes the diagnostics and the budgets of a tile.
pub(crate) struct WriteAccounts<'a, 'b, 'c, 'd> {
    pub tick: &'a TickContext,
    pub columns: &'a ColumnsMut<'b>,
    pub diagnostics: &'a mut slice::IterMut<'c, Diagnostic>,
    pub budgets: &'a mut slice::IterMut<'d, Budget>,
}

impl SimdTask for WriteAccounts<'_, '_, '_, '_> {
    #[inline(always)]
    fn run(self) {
        let (tick, columns) = (self.tick, self.columns);
        for (block, lanes) in slots::blocks(columns.words) {
            prefetch_ahead(self.diagnostics.as_slice());
            prefetch_ahead(self.budgets.as_slice());
            let block = columns.block(block);
            if self.diagnostics.len() > 0 {
                let diagnostics = Diagnostics::of(tick, block);
                for (lane, place) in slots::bits(lanes).zip(self.diagnostics.by_ref()) {
                    *place = diagnostics.get(tick, lane);
                }
            }
            if self.budgets.len() > 0 {
                let budgets = Budgets::of(tick, block);
                for (lane, place) in slots::bits(lanes).zip(self.budgets.by_ref()) {
                    *place = budgets.get(tick, lane);
                }
            }
        }
    }
}
