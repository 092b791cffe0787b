//! Bridges gaps: the model runs open loop up to the sample.

use crate::estimate::window::{Gap, Window};
use crate::ingest::admission::AdmissionState;
use crate::ingest::pending::Pending;
use crate::layout::lanes::{self, Block as _, LANES};
use crate::state::columns::ColumnsMut;
use crate::tick::batch::Batch;
use crate::tick::features::step::step;
use crate::tick::infer::{infer, infer_open};
use crate::tick::platform_context::PlatformContext;

/// Runs robots with a gap before their waiting sample open loop up to it, one step per round, and
/// then takes the samples. The rows collected so far are inferred first, because the batch is
/// reused.
#[cold]
#[inline(never)]
pub(crate) fn bridge(context: &PlatformContext, columns: &mut ColumnsMut<'_>, batch: &mut Batch) {
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
                let (command, _) = columns.energy[slot / LANES].command(slot % LANES);
                let row = window.open_towards(steps, command);
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

#[inline]
pub(crate) fn gap(
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
    window.gap_before(elapsed_ns, context.platform.period_ns, context.longest_steps)
}
