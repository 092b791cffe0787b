//! Inference: rows through the model, forecasts into windows, and open loop for robots whose next
//! sample is overdue.

// Index loops: the compiler vectorises them.
#![allow(clippy::needless_range_loop)]

use joulebus_predictor::ReadingAge;
use joulebus_predictor::simd::SimdTask;
use joulebus_wire::{InvalidReason, Quality};

use crate::estimate::online::{Members, OnlineLanes};
use crate::estimate::window::WindowLanes;
use crate::layout::lanes::{self, Block as _, LANES, Lanes, put};
use crate::state::columns::ColumnsMut;
use crate::tick::batch::{Batch, Inferred};
use crate::tick::context::TickContext;
use crate::tick::platform_context::{PlatformContext, PossiblePower};

/// Infers the collected rows.
pub(crate) fn infer(context: &PlatformContext, columns: &mut ColumnsMut<'_>, batch: &mut Batch) {
    if batch.is_empty() {
        return;
    }
    batch.infer(&context.model);
    batch.mark_outside(context);
    context.model.simd_level().run(Store {
        members: context.members,
        possible: context.possible(),
        columns,
        batch,
    });
}

pub(crate) fn infer_open(
    context: &PlatformContext,
    columns: &mut ColumnsMut<'_>,
    batch: &mut Batch,
) -> bool {
    if batch.is_empty() {
        return false;
    }
    batch.infer(&context.model);
    let possible = context.possible();
    for (slot, network_w) in batch.forecasts() {
        let is_number = context.members.is_some() || possible.is_near(network_w);
        let mut forecast_w = if is_number { network_w } else { f32::NAN };
        if let (Some(members), true) = (&context.members, network_w.is_finite()) {
            let window = lanes::get(columns.windows, slot);
            let online = lanes::get(columns.online, slot);
            let lag_w = window.open_lags_w();
            forecast_w = online.forecast(members, &lag_w, network_w, window.shown_due());
        }
        columns.windows[slot / LANES].opened(slot % LANES, possible.nearest(forecast_w));
    }
    true
}

/// Stores the results of inference, a block at a time.
struct Store<'a, 'b> {
    members: Option<Members>,
    possible: PossiblePower,
    columns: &'a mut ColumnsMut<'b>,
    batch: &'a Batch,
}

impl SimdTask for Store<'_, '_> {
    #[inline(always)]
    fn run(self) {
        let (columns, mut row) = (self.columns, 0);
        let (members, possible) = (self.members.as_ref(), self.possible);
        while let Some((inferred, next)) = self.batch.of_block(row) {
            row = next;
            store_block((members, possible), columns, &inferred);
        }
    }
}

#[inline(always)]
fn store_block(
    (members, possible): (Option<&Members>, PossiblePower),
    columns: &mut ColumnsMut<'_>,
    inferred: &Inferred,
) {
    let windows = &mut columns.windows[inferred.block];
    let (mut finite, mut invalid) = ([false; LANES], [false; LANES]);
    for lane in 0..LANES {
        // Where robots learn nothing, nobody else judges the output of the network.
        let network_w = inferred.forecast_w[lane];
        let is_number = network_w.is_finite() & (members.is_some() | possible.is_near(network_w));
        finite[lane] = inferred.rows[lane] & is_number;
        invalid[lane] = inferred.rows[lane] & !is_number;
    }
    let mut forecast_w = inferred.forecast_w;
    if let Some(members) = members {
        let online = &mut columns.online[inferred.block];
        for lane in 0..LANES {
            put(&mut online.network_w[lane], finite[lane], forecast_w[lane]);
        }
        combine(members, windows, online, &mut forecast_w);
    }
    for lane in 0..LANES {
        windows.forecast(lane, finite[lane], possible.nearest(forecast_w[lane]));
    }
    let first = inferred.block * LANES;
    if lanes::any(&invalid) {
        for lane in (0..LANES).filter(|lane| invalid[*lane]) {
            refuse(columns, first + lane);
        }
    }
    if lanes::any(&inferred.outside) {
        for lane in (0..LANES).filter(|lane| inferred.outside[*lane]) {
            columns.admissions[first + lane].outside_training = true;
        }
    }
}

/// Replaces the network's forecasts of a block by the robots' own.
#[inline(always)]
fn combine(
    members: &Members,
    windows: &WindowLanes,
    online: &OnlineLanes,
    forecast_w: &mut Lanes<f32>,
) {
    let members = *members;
    for lane in 0..LANES {
        let (window, robot) = (windows.closed.get(lane), online.get(lane));
        let (lag_w, due) = (window.lags_w(), window.due());
        forecast_w[lane] = robot.forecast(&members, &lag_w, robot.network_w, due);
    }
}

/// The network has no number for this robot.
#[cold]
#[inline(never)]
fn refuse(columns: &mut ColumnsMut<'_>, slot: usize) {
    let mut last = lanes::get(columns.lasts, slot);
    let invalid = Quality::Invalid(InvalidReason::ModelOutput);
    (last.quality, last.quality_detail) = invalid.encode();
    lanes::set(columns.lasts, slot, last);
}

/// Forecasts robots whose sample is overdue in open loop. The forecast is provisional, and
/// discarded if the sample disagrees.
pub(crate) fn run_overdue(
    tick: &TickContext,
    context: &PlatformContext,
    columns: &mut ColumnsMut<'_>,
    batch: &mut Batch,
) {
    let overdue = std::mem::take(&mut batch.overdue);
    while !overdue.is_empty() {
        batch.clear();
        for slot in overdue.iter().map(|slot| *slot as usize) {
            let silent_ns = tick.now_ns.saturating_sub(columns.admissions[slot].taken_ns);
            let steps = ReadingAge::missing_steps(silent_ns, context.platform.period_ns);
            let mut window = lanes::get(columns.windows, slot);
            let longest = context.longest_steps.saturating_sub(window.unread_steps);
            let steps = steps.min(longest.into()) as u16;
            if steps == 0 {
                continue;
            }
            let (command, _) = columns.energy[slot / LANES].command(slot % LANES);
            let row = window.open_towards(steps, command);
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
