//! Inference: rows through the model, forecasts into windows; and open loop for robots whose next
//! sample is overdue.

// Lanes are counted: that is the loop that the compiler makes vectors of.
#![allow(clippy::needless_range_loop)]

use joulebus_predictor::SimdTask;
use joulebus_wire::{InvalidReason, Quality};

use crate::estimate::online::{Members, OnlineLanes};
use crate::estimate::window::{WindowLanes, missing_steps};
use crate::layout::lanes::{self, Block as _, LANES};
use crate::state::columns::ColumnsMut;
use crate::tick::batch::Batch;
use crate::tick::context::TickContext;
use crate::tick::platform_context::{PlatformContext, PossiblePower};

/// Infers the collected rows.
pub(crate) fn infer(context: &PlatformContext, columns: &mut ColumnsMut<'_>, batch: &mut Batch) {
    if batch.is_empty() {
        return;
    }
    batch.infer(&context.model);
    for (slot, network_w) in batch.forecasts() {
        if network_w.is_finite() {
            columns.windows[slot / LANES].forecast(slot % LANES, network_w);
            if context.members.is_some() {
                columns.online[slot / LANES].network_w[slot % LANES] = network_w;
            }
        } else {
            let mut last = lanes::get(columns.lasts, slot);
            let invalid = Quality::Invalid(InvalidReason::ModelOutput);
            (last.quality, last.quality_detail) = invalid.encode();
            lanes::set(columns.lasts, slot, last);
        }
    }
    if let Some(members) = &context.members {
        context.model.simd_level().run(Combine {
            members,
            possible: context.possible(),
            columns,
            forecast_lanes: batch.forecast_lanes(),
        });
    }
    batch.mark_outside(context);
    for (slot, outside) in batch.outside() {
        columns.admissions[slot].outside_training = outside;
    }
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
        let mut forecast_w = network_w;
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

/// Replaces the network's forecasts in the windows by the robots' own, a block at a time.
struct Combine<'a, 'b> {
    members: &'a Members,
    possible: PossiblePower,
    columns: &'a mut ColumnsMut<'b>,
    forecast_lanes: &'a [u16],
}

impl SimdTask for Combine<'_, '_> {
    #[inline(always)]
    fn run(self) {
        let ColumnsMut {
            windows, online, ..
        } = self.columns;
        let (members, possible) = (*self.members, self.possible);
        for (block, bits) in self.forecast_lanes.iter().enumerate() {
            if *bits != 0 {
                let online = &online[block];
                combine_block((&members, possible), *bits, &mut windows[block], online);
            }
        }
    }
}

#[inline(always)]
fn combine_block(
    (members, possible): (&Members, PossiblePower),
    bits: u16,
    windows: &mut WindowLanes,
    online: &OnlineLanes,
) {
    let mut forecast_w = [0.0; LANES];
    for lane in 0..LANES {
        let (window, robot) = (windows.closed.get(lane), online.get(lane));
        let (lag_w, due) = (window.lags_w(), window.due());
        let combined_w = robot.forecast(members, &lag_w, robot.network_w, due);
        forecast_w[lane] = possible.nearest(combined_w);
    }
    for lane in 0..LANES {
        windows.replace_forecast(lane, bits >> lane & 1 == 1, forecast_w[lane]);
    }
}

/// Forecasts robots whose sample is overdue open loop: provisional, and discarded where the sample says
/// otherwise.
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
            let silent_ns = tick
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
