//! Features: every waiting sample is one step of its robot, and all steps of a platform share one
//! batch of rows. Robots are independent.

mod block;
mod bridge;
mod step;

use joulebus_predictor::simd::SimdTask;

use crate::estimate::energy::EnergyLanes;
use crate::ingest::pending::PendingState;
use crate::layout::lanes::{self, Block as _, LANES, Lanes};
use crate::layout::slots;
use crate::state::columns::ColumnsMut;
use crate::tick::batch::Batch;
use crate::tick::context::TickContext;
use crate::tick::features::block::{InSequence, step_block};
use crate::tick::features::bridge::{bridge, gap};
use crate::tick::features::step::step;
use crate::tick::platform_context::PlatformContext;

/// Result of one pass over a tile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct TilePass {
    /// The next platform with robots in the tile, if any.
    pub next: Option<u16>,
    /// When the oldest of the robots' last samples was taken, monotonic ns.
    pub oldest_ns: u64,
}

/// Takes the waiting samples of a platform's robots and collects the rows for their forecasts.
/// `ticking`: also resets the per-tick counters, and lists the robots whose next sample is overdue.
pub(crate) fn build_rows(
    tick: &TickContext,
    platform: u16,
    columns: &mut ColumnsMut<'_>,
    batch: &mut Batch,
    ticking: bool,
) -> TilePass {
    let mut found = TilePass { next: None, oldest_ns: u64::MAX };
    tick.simd_level.run(BuildRows { tick, platform, columns, batch, ticking, found: &mut found });
    found
}

struct BuildRows<'a, 'b> {
    tick: &'a TickContext,
    platform: u16,
    columns: &'a mut ColumnsMut<'b>,
    batch: &'a mut Batch,
    ticking: bool,
    found: &'a mut TilePass,
}

impl SimdTask for BuildRows<'_, '_> {
    #[inline(always)]
    fn run(mut self) {
        let context = &self.tick.platforms[usize::from(self.platform)];
        self.batch.begin(context);
        for (block, lanes) in slots::blocks(self.columns.words) {
            lanes::prefetch_ahead(self.columns.admissions.as_chunks::<LANES>().0, block);
            lanes::prefetch_ahead(self.columns.pending, block);
            lanes::prefetch_ahead(self.columns.windows, block);
            lanes::prefetch_ahead(self.columns.lasts, block);
            lanes::prefetch_ahead(self.columns.intervals, block);
            lanes::prefetch_ahead(self.columns.online, block);
            EnergyLanes::prefetch_ahead(self.columns.energy, block);
            let Some(waiting) = self.collect_waiting(context, block, lanes) else {
                continue;
            };
            if lanes::any(&waiting.in_sequence) {
                let next =
                    InSequence { mask: &waiting.in_sequence, elapsed_ns: &waiting.elapsed_ns };
                step_block(context, self.columns, block, &next, self.batch);
            }
            // Gaps and missing readings differ between robots, so these are stepped one by one.
            if lanes::any(&waiting.irregular) {
                self.step_each(context, block, &waiting.irregular);
            }
        }
        if !self.batch.gaps.is_empty() {
            bridge(context, self.columns, self.batch);
        }
    }
}

/// The waiting samples of one platform in a block.
struct Waiting {
    /// Lanes whose sample has a reading and follows the last one without a gap.
    in_sequence: Lanes<bool>,
    /// Lanes whose sample does not.
    irregular: Lanes<bool>,
    /// Time since the previous sample, ns.
    elapsed_ns: Lanes<u64>,
}

impl BuildRows<'_, '_> {
    /// Resets the per-tick counters of a block's robots, and finds the waiting samples. `None` if
    /// no robot of the block belongs to the platform.
    #[inline(always)]
    fn collect_waiting(
        &mut self,
        context: &PlatformContext,
        block: usize,
        lanes: u16,
    ) -> Option<Waiting> {
        let (mut members, mut stamp_ns) = ([false; LANES], [0; LANES]);
        for lane in slots::bits(lanes) {
            let slot = block * LANES + lane;
            let admission = &mut self.columns.admissions[slot];
            // Robots of several platforms may share a block. Each pass serves one platform, in
            // ascending order, and finds the next.
            if admission.platform != self.platform {
                let next = self.found.next.is_none_or(|next| admission.platform < next);
                if admission.platform > self.platform && next {
                    self.found.next = Some(admission.platform);
                }
                continue;
            }
            if self.ticking {
                (admission.taken, admission.reported) = (0, false);
                self.found.oldest_ns = self.found.oldest_ns.min(admission.taken_ns);
                if self.tick.now_ns.saturating_sub(admission.taken_ns) > context.overdue_after_ns {
                    self.batch.overdue.push(slot as u32);
                }
            }
            (members[lane], stamp_ns[lane]) = (true, admission.stamp_ns);
        }
        if !lanes::any(&members) {
            return None;
        }
        let pending_block = &self.columns.pending[block];
        let mut waiting = Waiting {
            in_sequence: [false; LANES],
            irregular: [false; LANES],
            elapsed_ns: [0; LANES],
        };
        // `&` in place of `&&`: branches would keep the loop from being vectorised.
        for lane in 0..LANES {
            let pending = pending_block.samples.get(lane);
            let elapsed_ns = pending.stamp_ns.saturating_sub(stamp_ns[lane]);
            let waits = members[lane] & pending_block.is(lane, PendingState::Waiting);
            let on_time = elapsed_ns <= context.overdue_after_ns;
            let next = pending.read() & !pending.broken & on_time;
            waiting.in_sequence[lane] = waits & next;
            waiting.irregular[lane] = waits & !next;
            waiting.elapsed_ns[lane] = elapsed_ns;
        }
        Some(waiting)
    }

    /// Takes the irregular samples of a block one by one.
    #[inline(never)]
    fn step_each(&mut self, context: &PlatformContext, block: usize, mask: &Lanes<bool>) {
        for lane in (0..LANES).filter(|lane| mask[*lane]) {
            let slot = block * LANES + lane;
            let pending = self.columns.pending[block].samples.get(lane);
            let window = lanes::get(self.columns.windows, slot);
            let gap = gap(context, &self.columns.admissions[slot], &window, &pending);
            if window.can_close(gap) {
                step(context, self.columns, slot, &pending, gap, self.batch);
            } else {
                // Its window needs forecasts over the gap: `bridge` computes them for all such
                // robots as one batch.
                self.batch.gaps.push(slot as u32);
            }
        }
    }
}
