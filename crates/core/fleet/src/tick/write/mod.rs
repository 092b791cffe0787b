//! Output of the tick in the layout of shared memory: arithmetic is done a block of robots at a
//! time, then each robot is stored to its place.

pub(crate) mod budgets;
pub(crate) mod diagnostics;
pub(crate) mod flag;
pub(crate) mod forecasts;
pub(crate) mod learned;
pub(crate) mod outlooks;
pub(crate) mod plan_states;

use std::slice;

use joulebus_predictor::simd::{SimdTask, prefetch};
use joulebus_wire::Forecast;

use crate::layout::lanes::{AHEAD, LANES};
use crate::layout::slots;
use crate::state::columns::ColumnsMut;
use crate::tick::context::TickContext;
use crate::tick::outputs::SecondaryRows;
use crate::tick::write::budgets::BudgetRows;
use crate::tick::write::diagnostics::DiagnosticRows;
use crate::tick::write::forecasts::ForecastRows;
use crate::tick::write::learned::LearnedLanes;
use crate::tick::write::outlooks::OutlookRows;
use crate::tick::write::plan_states::PlanStateRows;

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
            let forecasts = ForecastRows::new(columns.block(block));
            for (lane, place) in slots::bits(lanes).zip(self.places.by_ref()) {
                *place = forecasts.get(tick, lane);
            }
        }
    }
}

/// Writes the diagnostics, the budgets, the plan states and the outlooks of a tile.
pub(crate) struct WriteSecondary<'a, 'b, 'c> {
    pub tick: &'a TickContext,
    pub columns: &'a ColumnsMut<'b>,
    pub places: &'a mut SecondaryRows<'c>,
}

impl SimdTask for WriteSecondary<'_, '_, '_> {
    #[inline(always)]
    fn run(self) {
        let (tick, columns) = (self.tick, self.columns);
        let SecondaryRows { diagnostics, budgets, plan_states, outlooks } = self.places;
        for (block, lanes) in slots::blocks(columns.words) {
            prefetch_ahead(diagnostics.as_slice());
            prefetch_ahead(budgets.as_slice());
            prefetch_ahead(plan_states.as_slice());
            prefetch_ahead(outlooks.as_slice());
            let block = columns.block(block);
            if budgets.len() + outlooks.len() > 0 {
                let rows = BudgetRows::new(tick, block);
                for (lane, place) in slots::bits(lanes).zip(budgets.by_ref()) {
                    *place = rows.get(tick, lane);
                }
                if outlooks.len() > 0 {
                    let ahead = OutlookRows::new(tick, block);
                    for (lane, place) in slots::bits(lanes).zip(outlooks.by_ref()) {
                        *place = ahead.get(tick, lane, &rows.get(tick, lane));
                    }
                }
            }
            if diagnostics.len() + plan_states.len() == 0 {
                continue;
            }
            let learned = LearnedLanes::new(tick, &block);
            if diagnostics.len() > 0 {
                let rows = DiagnosticRows::new(block, &learned);
                for (lane, place) in slots::bits(lanes).zip(diagnostics.by_ref()) {
                    *place = rows.get(tick, lane);
                }
            }
            if plan_states.len() > 0 {
                let rows = PlanStateRows::new(block, &learned);
                for (lane, place) in slots::bits(lanes).zip(plan_states.by_ref()) {
                    *place = rows.get(tick, lane);
                }
            }
        }
    }
}
