//! The pass over one tile: every waiting sample is one step of its robot, and all steps of a
//! platform share one batch. Robots do not see each other.

pub(crate) mod block;
pub(crate) mod step;

use joulebus_predictor::{SimdLevel, SimdTask};
use joulebus_settings::FleetSettings;
use joulebus_wire::{InvalidReason, Quality};

use crate::estimate::window::{Gap, Window, missing_steps};
use crate::ingest::robot::{AdmissionState, Pending, PendingState};
use crate::layout::lanes::{self, Block as _, LANES, Lanes};
use crate::layout::slots;
use crate::state::columns::ColumnsMut;
use crate::tick::batch::Batch;
use crate::tick::features::block::{Next, step_block};
use crate::tick::features::step::step;
use crate::tick::platform_context::PlatformContext;

/// What a pass reads and never writes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rules<'a> {
    pub settings: &'a FleetSettings,
    pub contexts: &'a [PlatformContext],
    /// What all but the models is compiled for.
    pub simd_level: SimdLevel,
    pub now_ns: u64,
    pub deadline_missed: bool,
}

/// What a look at a tile has found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Found {
    /// The next platform that has robots in the tile, if any.
    pub next: Option<u16>,
    /// When the sample that is longest ago was taken, monotonic ns.
    pub oldest_ns: u64,
}

/// Takes the waiting samples of a platform's robots and collects the rows for their forecasts.
/// `ticking`: also ends the robots' tick and notes whose next sample is overdue.
pub(crate) fn absorb(
    rules: &Rules<'_>,
    context: u16,
    columns: &mut ColumnsMut<'_>,
    batch: &mut Batch,
    ticking: bool,
) -> Found {
    let mut found = Found {
        next: None,
        oldest_ns: u64::MAX,
    };
    rules.simd_level.run(Absorb {
        rules,
        context,
        columns,
        batch,
        ticking,
        found: &mut found,
    });
    found
}

struct Absorb<'a, 'b> {
    rules: &'a Rules<'a>,
    context: u16,
    columns: &'a mut ColumnsMut<'b>,
    batch: &'a mut Batch,
    ticking: bool,
    found: &'a mut Found,
}

impl SimdTask for Absorb<'_, '_> {
    #[inline(always)]
    fn run(mut self) {
        let its = &self.rules.contexts[usize::from(self.context)];
        self.batch.begin(its);
        for (block, lanes) in slots::blocks(self.columns.words) {
            lanes::prefetch_ahead(self.columns.admissions.as_chunks::<LANES>().0, block);
            lanes::prefetch_ahead(self.columns.pending, block);
            lanes::prefetch_ahead(self.columns.windows, block);
            lanes::prefetch_ahead(self.columns.lasts, block);
            lanes::prefetch_ahead(self.columns.intervals, block);
            let Some(entered) = self.enter(its, block, lanes) else {
                continue;
            };
            if lanes::any(&entered.smooth) {
                let next = Next {
                    which: &entered.smooth,
                    elapsed_ns: &entered.elapsed_ns,
                };
                step_block(its, self.columns, block, &next, self.batch);
            }
            if lanes::any(&entered.rough) {
                self.step_each(its, block, &entered.rough);
            }
        }
        if !self.batch.gaps.is_empty() {
            bridge(its, self.columns, self.batch);
        }
    }
}

/// What waits in a block for one platform.
struct Entered {
    /// Whose sample is the next of its robot, with a reading.
    smooth: Lanes<bool>,
    /// Whose sample is not.
    rough: Lanes<bool>,
    /// Time since the sample before, ns.
    elapsed_ns: Lanes<u64>,
}

impl Absorb<'_, '_> {
    /// Ends the tick of a block's robots, and looks what waits; `None` if no robot of it is of the
    /// platform.
    #[inline(always)]
    fn enter(&mut self, its: &PlatformContext, block: usize, lanes: u16) -> Option<Entered> {
        let (mut ours, mut stamp_ns) = ([false; LANES], [0; LANES]);
        for lane in slots::bits(lanes) {
            let slot = block * LANES + lane;
            let admission = &mut self.columns.admissions[slot];
            if admission.platform != self.context {
                let next = self.found.next.is_none_or(|next| admission.platform < next);
                if admission.platform > self.context && next {
                    self.found.next = Some(admission.platform);
                }
                continue;
            }
            if self.ticking {
                (admission.taken, admission.heard) = (0, false);
                self.found.oldest_ns = self.found.oldest_ns.min(admission.taken_ns);
                if self.rules.now_ns.saturating_sub(admission.taken_ns) > its.overdue_after_ns {
                    self.batch.overdue.push(slot as u32);
                }
            }
            (ours[lane], stamp_ns[lane]) = (true, admission.stamp_ns);
        }
        if !lanes::any(&ours) {
            return None;
        }
        let pending_block = &self.columns.pending[block];
        let mut entered = Entered {
            smooth: [false; LANES],
            rough: [false; LANES],
            elapsed_ns: [0; LANES],
        };
        for lane in 0..LANES {
            let pending = pending_block.samples.get(lane);
            let elapsed_ns = pending.stamp_ns.saturating_sub(stamp_ns[lane]);
            let waits = ours[lane] & pending_block.is(lane, PendingState::Waiting);
            let on_time = elapsed_ns <= its.overdue_after_ns;
            let next = pending.read() & !pending.broken & on_time;
            entered.smooth[lane] = waits & next;
            entered.rough[lane] = waits & !next;
            entered.elapsed_ns[lane] = elapsed_ns;
        }
        Some(entered)
    }

    /// Takes samples of a block one by one.
    #[inline(never)]
    fn step_each(&mut self, its: &PlatformContext, block: usize, which: &Lanes<bool>) {
        for lane in (0..LANES).filter(|lane| which[*lane]) {
            let slot = block * LANES + lane;
            let pending = self.columns.pending[block].samples.get(lane);
            let window = lanes::get(self.columns.windows, slot);
            let gap = gap(its, &self.columns.admissions[slot], &window, &pending);
            if window.can_close(gap) {
                step(its, self.columns, slot, &pending, gap, self.batch);
            } else {
                self.batch.gaps.push(slot as u32);
            }
        }
    }
}

/// Runs the collected rows through the model.
pub(crate) fn infer(context: &PlatformContext, columns: &mut ColumnsMut<'_>, batch: &mut Batch) {
    if batch.is_empty() {
        return;
    }
    batch.infer(&context.model);
    if let Some(blending) = &context.blending {
        batch.blend(blending, columns, false);
    }
    for (slot, forecast_w) in batch.forecasts() {
        if forecast_w.is_finite() {
            columns.windows[slot / LANES].forecast(slot % LANES, forecast_w);
        } else {
            let mut last = lanes::get(columns.lasts, slot);
            let invalid = Quality::Invalid(InvalidReason::ModelOutput);
            (last.quality, last.quality_detail) = invalid.encode();
            lanes::set(columns.lasts, slot, last);
        }
    }
    batch.mark_outside(context);
    for (slot, outside) in batch.outside() {
        columns.admissions[slot].outside_training = outside;
    }
}

/// Runs robots with a gap before their waiting sample open loop up to it, a step per round, and
/// then takes the samples. The rows collected so far are run as well: they are in the way.
#[cold]
#[inline(never)]
fn bridge(context: &PlatformContext, columns: &mut ColumnsMut<'_>, batch: &mut Batch) {
    infer(context, columns, batch);
    let late = std::mem::take(&mut batch.gaps);
    let look = |columns: &ColumnsMut<'_>, slot: usize| {
        let pending = columns.pending[slot / LANES].samples.get(slot % LANES);
        let window = lanes::get(columns.windows, slot);
        let gap = gap(context, &columns.admissions[slot], &window, &pending);
        (pending, window, gap)
    };
    loop {
        batch.clear();
        for slot in late.iter().map(|slot| *slot as usize) {
            if let (_, mut window, Gap::Bridge(steps)) = look(columns, slot) {
                let row = window.open_towards(steps);
                lanes::set(columns.windows, slot, window);
                if let Some(row) = row {
                    batch.push(slot, &row);
                }
            }
        }
        if !infer_open(context, columns, batch) {
            break;
        }
    }
    for slot in late.iter().map(|slot| *slot as usize) {
        let (pending, _, gap) = look(columns, slot);
        step(context, columns, slot, &pending, gap, batch);
    }
    batch.gaps = late;
}

/// Shows robots whose sample is overdue what the model expects: provisional, undone by the sample
/// if it says otherwise.
pub(crate) fn run_open(
    rules: &Rules<'_>,
    context: &PlatformContext,
    columns: &mut ColumnsMut<'_>,
    batch: &mut Batch,
) {
    let overdue = std::mem::take(&mut batch.overdue);
    while !overdue.is_empty() {
        batch.clear();
        for slot in overdue.iter().map(|slot| *slot as usize) {
            let silent_ns = rules
                .now_ns
                .saturating_sub(columns.admissions[slot].taken_ns);
            let steps = missing_steps(silent_ns, context.platform.period_ns);
            let mut window = lanes::get(columns.windows, slot);
            let longest = context.longest_steps.saturating_sub(window.unread_steps);
            let steps = steps.min(longest.into()) as u16;
            if steps == 0 {
                continue;
            }
            let row = window.open_towards(steps);
            lanes::set(columns.windows, slot, window);
            if let Some(row) = row {
                batch.push(slot, &row);
            }
        }
        if !infer_open(context, columns, batch) {
            break;
        }
    }
    batch.overdue = overdue;
}

fn infer_open(context: &PlatformContext, columns: &mut ColumnsMut<'_>, batch: &mut Batch) -> bool {
    if batch.is_empty() {
        return false;
    }
    batch.infer(&context.model);
    if let Some(blending) = &context.blending {
        batch.blend(blending, columns, true);
    }
    for (slot, forecast_w) in batch.forecasts() {
        columns.windows[slot / LANES].opened(slot % LANES, forecast_w);
    }
    true
}

#[inline]
fn gap(
    context: &PlatformContext,
    admission: &AdmissionState,
    window: &Window,
    pending: &Pending,
) -> Gap {
    if pending.broken {
        return Gap::Break;
    }
    let elapsed_ns = pending.stamp_ns.saturating_sub(admission.stamp_ns);
    if elapsed_ns <= context.overdue_after_ns {
        return Gap::None;
    }
    window.gap_before(
        elapsed_ns,
        context.platform.period_ns,
        context.longest_steps,
    )
}
