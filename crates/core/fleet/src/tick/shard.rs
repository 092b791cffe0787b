//! The tick of a shard of the fleet, tile by tile.

use std::slice;
use std::sync::atomic::{AtomicU64, Ordering};

use joulebus_wire::Forecast;

use crate::layout::slots::words_of;
use crate::state::columns::ColumnsMut;
use crate::tick::batch::Batch;
use crate::tick::context::TickContext;
use crate::tick::features::build_rows;
use crate::tick::infer::{infer, run_overdue};
use crate::tick::outputs::{Outputs, SecondaryOutputs, SecondaryRows};
use crate::tick::score::Score;
use crate::tick::write::{WriteForecasts, WriteSecondary};

/// The stages of a tick, for time measurements.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Stage {
    /// Samples absorbed, lag windows and intervals advanced, features laid out in columns.
    Features,
    /// The model, and its forecasts stored.
    Network,
    /// Ledgers, scores, residuals and alarms.
    Bookkeeping,
    /// Forecasts, diagnostics, budgets, plan states and outlooks written.
    Writing,
}

impl Stage {
    /// All stages. The position is `stage as usize`.
    pub const ALL: [Self; 4] = [Self::Features, Self::Network, Self::Bookkeeping, Self::Writing];
}

/// Robots ticked by one thread: disjoint from all other shards of the fleet, so that each may be
/// processed by a different thread. The output of a robot does not depend on how the fleet is
/// split.
///
/// A shard is ticked by [`Shard::forecast`] and then [`Shard::account`], or by [`Shard::run`],
/// which does both tile by tile. `on` is called after each stage of each tile, for time
/// measurements.
#[derive(Debug)]
pub struct Shard<'a> {
    pub(crate) tick: &'a TickContext,
    pub(crate) columns: ColumnsMut<'a>,
    pub(crate) oldest_ns: &'a AtomicU64,
}

impl<'a> Shard<'a> {
    /// Number of robots.
    pub fn len(&self) -> usize {
        self.columns.robots()
    }

    /// True if it has no robot.
    pub fn is_empty(&self) -> bool {
        self.columns.words.iter().all(|word| *word == 0)
    }

    /// The same robots, for a pass of their own.
    pub fn reborrow(&mut self) -> Shard<'_> {
        Shard { tick: self.tick, columns: self.columns.reborrow(), oldest_ns: self.oldest_ns }
    }

    /// Two shards: the first has at least `robots` robots, if there are as many, and at most 63
    /// more. The second has all others. Places continue from the first to the second.
    pub fn split_at(self, robots: usize) -> (Self, Self) {
        let words = words_of(self.columns.words, robots).end;
        self.split_words(words)
    }

    /// Absorbs samples, forecasts, and writes the forecasts: as many as there are robots, in the
    /// order of their places. Further elements of `forecasts` are unchanged, and robots beyond its
    /// length are not written.
    pub fn forecast(
        &mut self,
        batch: &mut Batch,
        forecasts: &mut [Forecast],
        on: &mut dyn FnMut(Stage),
    ) {
        let mut forecasts = forecasts.iter_mut();
        self.each_tile(batch.words, |tile| {
            tile.infer(batch, on);
            tile.write_forecasts(&mut forecasts);
            on(Stage::Writing);
        });
    }

    /// Scores the samples that [`Shard::forecast`] absorbed, and writes the other outputs. Empty slices
    /// are not written.
    pub fn account(
        &mut self,
        batch: &mut Batch,
        secondary: SecondaryOutputs<'_>,
        on: &mut dyn FnMut(Stage),
    ) {
        let mut secondary = secondary.places();
        self.each_tile(batch.words, |tile| {
            tile.score();
            on(Stage::Bookkeeping);
            tile.write_secondary(&mut secondary);
            on(Stage::Writing);
        });
    }

    /// [`Shard::forecast`] and [`Shard::account`] in one pass through memory.
    pub fn run(&mut self, batch: &mut Batch, outputs: Outputs<'_>, on: &mut dyn FnMut(Stage)) {
        let mut forecasts = outputs.forecasts.iter_mut();
        let mut secondary = outputs.secondary.places();
        self.each_tile(batch.words, |tile| {
            tile.infer(batch, on);
            tile.score();
            on(Stage::Bookkeeping);
            tile.write_forecasts(&mut forecasts);
            tile.write_secondary(&mut secondary);
            on(Stage::Writing);
        });
    }

    fn infer(&mut self, batch: &mut Batch, on: &mut dyn FnMut(Stage)) {
        let (tick, columns) = (self.tick, &mut self.columns);
        let mut next = Some(0);
        while let Some(platform) = next {
            let found = build_rows(tick, platform, columns, batch, true);
            on(Stage::Features);
            let context = &tick.platforms[usize::from(platform)];
            infer(context, columns, batch);
            run_overdue(tick, context, columns, batch);
            on(Stage::Network);
            self.oldest_ns.fetch_min(found.oldest_ns, Ordering::Relaxed);
            next = found.next;
        }
    }

    fn score(&mut self) {
        let (tick, columns) = (self.tick, &mut self.columns);
        tick.simd_level.run(Score { tick, columns });
    }

    fn write_forecasts(&self, places: &mut slice::IterMut<'_, Forecast>) {
        self.tick.simd_level.run(WriteForecasts {
            tick: self.tick,
            columns: &self.columns,
            places,
        });
    }

    /// Each slice separately: an omitted one must not suppress the others.
    fn write_secondary(&self, places: &mut SecondaryRows<'_>) {
        self.tick.simd_level.run(WriteSecondary {
            tick: self.tick,
            columns: &self.columns,
            places,
        });
    }

    /// Calls `work` for each tile that has robots.
    fn each_tile(&mut self, words: usize, mut work: impl FnMut(&mut Shard<'_>)) {
        let mut rest = self.reborrow();
        while !rest.columns.words.is_empty() {
            let (mut tile, behind) = rest.split_words(words);
            if !tile.is_empty() {
                work(&mut tile);
            }
            rest = behind;
        }
    }

    fn split_words(self, words: usize) -> (Self, Self) {
        let (first, second) = self.columns.split(words);
        let shard = |columns| Shard { tick: self.tick, columns, oldest_ns: self.oldest_ns };
        (shard(first), shard(second))
    }
}
