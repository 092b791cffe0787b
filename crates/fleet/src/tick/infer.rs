//! Inference: rows through the model, forecasts into windows; and open loop for robots whose next
//! sample is overdue.

use joulebus_wire::{InvalidReason, Quality};

use crate::estimate::window::missing_steps;
use crate::layout::lanes::{self, LANES};
use crate::state::columns::ColumnsMut;
use crate::tick::batch::Batch;
use crate::tick::context::TickContext;
use crate::tick::platform_context::PlatformContext;

/// Infers the collected rows.
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

pub(crate) fn infer_open(
    context: &PlatformContext,
    columns: &mut ColumnsMut<'_>,
    batch: &mut Batch,
) -> bool {
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

/// Forecasts robots whose sample is overdue in open loop: provisional, and discarded when the
/// sample contradicts it.
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
