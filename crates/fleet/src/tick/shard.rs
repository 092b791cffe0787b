//! The tick of a share of the fleet, tile by tile.

use std::slice;
use std::sync::atomic::{AtomicU64, Ordering};

use joulebus_predictor::{SimdTask, prefetch};
use joulebus_wire::{Budget, Diagnostic, Forecast};

use crate::layout::lanes::{AHEAD, LANES};
use crate::layout::slots::{self, words_of};
use crate::state::columns::ColumnsMut;
use crate::tick::batch::Batch;
use crate::tick::features::{self, Rules};
use crate::tick::score::Account;
use crate::tick::write::{Budgets, Diagnostics, Forecasts};

/// What a share of the tick's time has gone to, for one tile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Samples absorbed, lag windows and intervals moved on, features laid in columns.
    Features,
    /// The model, and its forecasts taken.
    Network,
    /// Ledgers, scores, residuals and alarms.
    Bookkeeping,
    /// Forecasts, diagnostics and budgets written out.
    Writing,
}

impl Stage {
    /// All stages; the position is `stage as usize`.
    pub const ALL: [Self; 4] = [
        Self::Features,
        Self::Network,
        Self::Bookkeeping,
        Self::Writing,
    ];
}

/// Robots that one thread ticks: disjoint from all other shares of the fleet, so that each may be
/// worked on by a thread of its own. What any robot is told does not depend on how the fleet is
/// shared out.
///
/// A share is ticked by [`Share::forecast`] and then [`Share::account`], or by [`Share::run`], which
/// does both tile by tile. `on` is called after each stage of each tile, for whoever counts the time.
#[derive(Debug)]
pub struct Shard<'a> {
    pub(crate) rules: Rules<'a>,
    pub(crate) columns: ColumnsMut<'a>,
    pub(crate) oldest_ns: &'a AtomicU64,
}

/// Where [`Share::run`] writes: three slices as long as the share.
#[derive(Debug)]
pub struct Outputs<'a> {
    /// Forecasts.
    pub forecasts: &'a mut [Forecast],
    /// Diagnostics.
    pub diagnostics: &'a mut [Diagnostic],
    /// Budgets.
    pub budgets: &'a mut [Budget],
}

impl<'a> Outputs<'a> {
    /// The first `robots` of each, and the rest. What is shorter, for it is not to be written, ends
    /// with the first.
    #[must_use]
    pub fn split_at(self, robots: usize) -> (Self, Self) {
        let forecasts = self
            .forecasts
            .split_at_mut(robots.min(self.forecasts.len()));
        let diagnostics = self
            .diagnostics
            .split_at_mut(robots.min(self.diagnostics.len()));
        let budgets = self.budgets.split_at_mut(robots.min(self.budgets.len()));
        (
            Outputs {
                forecasts: forecasts.0,
                diagnostics: diagnostics.0,
                budgets: budgets.0,
            },
            Outputs {
                forecasts: forecasts.1,
                diagnostics: diagnostics.1,
                budgets: budgets.1,
            },
        )
    }
}

impl<'a> Shard<'a> {
    /// Robots in it.
    #[must_use]
    pub fn len(&self) -> usize {
        self.columns.robots()
    }

    /// Whether it holds no robot.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.columns.words.iter().all(|word| *word == 0)
    }

    /// Two shares: the first holds at least `robots` robots, if there are as many, and at most 63
    /// more; the second all others. Places are counted through the first and on into the second.
    #[must_use]
    pub fn split_at(self, robots: usize) -> (Self, Self) {
        let words = words_of(self.columns.words, robots).end;
        self.split_words(words)
    }

    /// Absorbs samples, forecasts, and writes the forecasts: as many as there are robots, in the
    /// order of their places; further elements of `forecasts` are left alone, and those of robots
    /// that find no room in it are not written.
    pub fn forecast(
        &mut self,
        batch: &mut Batch,
        forecasts: &mut [Forecast],
        on: &mut dyn FnMut(Stage),
    ) {
        let mut forecasts = forecasts.iter_mut();
        self.each_tile(batch.words, |tile| {
            tile.absorb(batch, on);
            tile.write_forecasts(&mut forecasts);
            on(Stage::Writing);
        });
    }

    /// Accounts for what [`Share::forecast`] absorbed, and writes the diagnostics and the budgets;
    /// an empty list is one that is not wanted.
    pub fn account(
        &mut self,
        batch: &mut Batch,
        diagnostics: &mut [Diagnostic],
        budgets: &mut [Budget],
        on: &mut dyn FnMut(Stage),
    ) {
        let (mut diagnostics, mut budgets) = (diagnostics.iter_mut(), budgets.iter_mut());
        self.each_tile(batch.words, |tile| {
            tile.settle();
            on(Stage::Bookkeeping);
            tile.write_accounts(&mut diagnostics, &mut budgets);
            on(Stage::Writing);
        });
    }

    /// [`Share::forecast`] and [`Share::account`] in one go through memory.
    pub fn run(&mut self, batch: &mut Batch, outputs: Outputs<'_>, on: &mut dyn FnMut(Stage)) {
        let Outputs {
            forecasts,
            diagnostics,
            budgets,
        } = outputs;
        let mut forecasts = forecasts.iter_mut();
        let (mut diagnostics, mut budgets) = (diagnostics.iter_mut(), budgets.iter_mut());
        self.each_tile(batch.words, |tile| {
            tile.absorb(batch, on);
            tile.settle();
            on(Stage::Bookkeeping);
            tile.write_forecasts(&mut forecasts);
            tile.write_accounts(&mut diagnostics, &mut budgets);
            on(Stage::Writing);
        });
    }

    fn absorb(&mut self, batch: &mut Batch, on: &mut dyn FnMut(Stage)) {
        let (rules, columns) = (self.rules, &mut self.columns);
        let mut next = Some(0);
        while let Some(context) = next {
            let found = features::absorb(&rules, context, columns, batch, true);
            on(Stage::Features);
            let its = &rules.contexts[usize::from(context)];
            features::infer(its, columns, batch);
            features::run_open(&rules, its, columns, batch);
            on(Stage::Network);
            self.oldest_ns.fetch_min(found.oldest_ns, Ordering::Relaxed);
            next = found.next;
        }
    }

    fn settle(&mut self) {
        let (rules, columns) = (self.rules, &mut self.columns);
        rules.simd_level.run(Account {
            rules: &rules,
            columns,
        });
    }

    fn write_forecasts(&self, places: &mut slice::IterMut<'_, Forecast>) {
        self.rules.simd_level.run(WriteForecasts {
            shard: self,
            places,
        });
    }

    /// Each list by itself: one that is left out must not keep the other from being written.
    fn write_accounts(
        &self,
        diagnostics: &mut slice::IterMut<'_, Diagnostic>,
        budgets: &mut slice::IterMut<'_, Budget>,
    ) {
        self.rules.simd_level.run(WriteAccounts {
            shard: self,
            diagnostics,
            budgets,
        });
    }

    /// Calls `work` with each tile that has robots in it.
    fn each_tile(&mut self, words: usize, mut work: impl FnMut(&mut Shard<'_>)) {
        let mut rest = Shard {
            rules: self.rules,
            columns: self.columns.reborrow(),
            oldest_ns: self.oldest_ns,
        };
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
        let shard = |columns| Shard {
            rules: self.rules,
            columns,
            oldest_ns: self.oldest_ns,
        };
        (shard(first), shard(second))
    }
}

/// Has the places of the next robots brought near.
#[inline(always)]
fn prefetch_ahead<T>(places: &[T]) {
    const FROM: usize = AHEAD * LANES;
    if let Some(places) = places.get(FROM..FROM + LANES) {
        prefetch(places);
    }
}

/// Writes the forecasts of a tile.
struct WriteForecasts<'a, 'b, 'c> {
    shard: &'a Shard<'b>,
    places: &'a mut slice::IterMut<'c, Forecast>,
}

impl SimdTask for WriteForecasts<'_, '_, '_> {
    #[inline(always)]
    fn run(self) {
        let Shard { rules, columns, .. } = self.shard;
        for (block, lanes) in slots::blocks(columns.words) {
            prefetch_ahead(self.places.as_slice());
            let forecasts = Forecasts::of(columns.seen(block));
            for (lane, place) in slots::bits(lanes).zip(self.places.by_ref()) {
                *place = forecasts.get(rules, lane);
            }
        }
    }
}

/// Writes the diagnostics and the budgets of a tile.
struct WriteAccounts<'a, 'b, 'c, 'd> {
    shard: &'a Shard<'b>,
    diagnostics: &'a mut slice::IterMut<'c, Diagnostic>,
    budgets: &'a mut slice::IterMut<'d, Budget>,
}

impl SimdTask for WriteAccounts<'_, '_, '_, '_> {
    #[inline(always)]
    fn run(self) {
        let Shard { rules, columns, .. } = self.shard;
        for (block, lanes) in slots::blocks(columns.words) {
            prefetch_ahead(self.diagnostics.as_slice());
            prefetch_ahead(self.budgets.as_slice());
            let seen = columns.seen(block);
            if self.diagnostics.len() > 0 {
                let diagnostics = Diagnostics::of(seen);
                for (lane, place) in slots::bits(lanes).zip(self.diagnostics.by_ref()) {
                    *place = diagnostics.get(rules, lane);
                }
            }
            if self.budgets.len() > 0 {
                let budgets = Budgets::of(rules, seen);
                for (lane, place) in slots::bits(lanes).zip(self.budgets.by_ref()) {
                    *place = budgets.get(rules, lane);
                }
            }
        }
    }
}
