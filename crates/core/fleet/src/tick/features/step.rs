//! One sample of one robot.

use joulebus_energy::EnergySample;
use joulebus_predictor::{INPUTS, LAGS, ReadingAge};
use joulebus_wire::{InvalidReason, Quality, sample_flag};

use crate::estimate::window::{Gap, RequiredInputs, Window};
use crate::ingest::pending::{Pending, PendingState};
use crate::layout::lanes::{Block as _, LANES, block};
use crate::state::columns::ColumnsMut;
use crate::tick::batch::Batch;
use crate::tick::platform_context::PlatformContext;

/// Takes the waiting sample of a slot, regular or not, and adds the row for its next forecast, if
/// there is one.
pub(crate) fn step(
    context: &PlatformContext,
    columns: &mut ColumnsMut<'_>,
    slot: usize,
    pending: &Pending,
    gap: Gap,
    batch: &mut Batch,
) {
    let (block, lane) = (slot / LANES, slot % LANES);
    let admission = &mut columns.admissions[slot];
    let mut window = columns.windows[block].get(lane);
    let mut last = columns.lasts[block].get(lane);
    let elapsed_ns = pending.stamp_ns.saturating_sub(admission.stamp_ns);
    // After a break the reading's age is unknown. After a gap it includes the missed periods.
    if pending.broken {
        window.reset_reading_age();
    } else if elapsed_ns > context.overdue_after_ns {
        window.skip_periods(ReadingAge::missing_steps(elapsed_ns, context.platform.period_ns));
    }
    let forecast_w = window.close(gap);
    let elapsed_s = seconds(elapsed_ns);
    let (before, _) = columns.energy[block].command(lane);
    last.seq = pending.seq;
    let step = if pending.read() {
        let mut network_w = forecast_w;
        if let Some(members) = &context.members {
            let mut online = columns.online[block].get(lane);
            // The stored network forecast is one step ahead, so it is not the one over a gap.
            if gap == Gap::None && !forecast_w.is_nan() {
                network_w = online.network_w;
            }
            if gap == Gap::None && window.is_scored() {
                online.learn(members, &window.lags_w(), window.due(), pending.power_w);
            }
            online.read(members, window.last_w(), window.due(), pending.power_w);
            if let Some(shown) = online.shown_start(members) {
                context.errors.show(admission.id, &shown);
            }
            columns.online[block].set(lane, true, online);
        }
        // After a gap it does not represent the power during it.
        last.read(pending, network_w, elapsed_s.min(seconds(context.platform.period_ns)));
        let forecast_w = (forecast_w, gap == Gap::None);
        let step = read(context.required, &mut window, pending, forecast_w, (before, elapsed_s));
        let quality = quality(context.required, pending, window.have(), step.ready);
        (last.quality, last.quality_detail) = quality;
        step
    } else {
        last.residual_w = f32::NAN;
        let step = miss(context, &mut window, pending, (before, elapsed_s));
        let quality = quality_unread(context.required, pending, &window, step.ready);
        (last.quality, last.quality_detail) = quality;
        step
    };
    let on_time = elapsed_ns <= context.overdue_after_ns;
    let mut energy = columns.energy[block].get(lane);
    let idle = pending.has(sample_flag::CHARGING) && columns.energy[block].is_settled(lane);
    let working_s = if idle { 0.0 } else { elapsed_s };
    let sample = energy_sample(pending, working_s, on_time);
    energy.metered.advance(&context.energy.command, &sample);
    if let Some(errors) = context.learned_errors().filter(|_| energy.metered.has_ended()) {
        let new = energy.compare(&context.energy, errors.platform(), sample.power_w);
        let level = columns.levels[block].get(lane).shown();
        errors.count((admission.id, level), &new, pending.has(sample_flag::CHARGING));
    }
    columns.energy[block].set(lane, true, energy);
    admission.accept(pending);
    columns.windows[block].set(lane, true, window);
    columns.lasts[block].set(lane, true, last);
    let pending_block = &mut columns.pending[block];
    let broken = gap == Gap::Break;
    pending_block.mark(
        lane,
        true,
        if broken { PendingState::Broken } else { PendingState::Absorbed },
    );
    pending_block.expected_w[lane] = step.expected_w;
    if !step.expected_w.is_nan() {
        let mut interval = columns.intervals[block].get(lane);
        let residual_w = pending.power_w - step.expected_w;
        interval.observe(
            residual_w,
            step.due,
            context.platform.power_resolution_w,
            context.quantile_step,
        );
        columns.intervals[block].set(lane, true, interval);
    }
    if step.ready {
        batch.push(slot, &step.row);
    }
}

/// The reading after a gap does not represent the power during it.
fn energy_sample(pending: &Pending, elapsed_s: f32, on_time: bool) -> EnergySample {
    let (v_mps, omega_radps) = pending.command().unwrap_or((f32::NAN, f32::NAN));
    EnergySample {
        power_w: if pending.read() & on_time { pending.power_w } else { f32::NAN },
        elapsed_s: if pending.broken { 0.0 } else { elapsed_s },
        v_mps,
        omega_radps,
    }
}

/// Takes a sample without a reading, `after` the previous one's command and that time, s.
fn miss(
    context: &PlatformContext,
    window: &mut Window,
    pending: &Pending,
    after: ((f32, f32), f32),
) -> Step {
    window.miss(context.longest_steps);
    let (row, ready) = window.next_row(after, pending.command(), context.required);
    Step { expected_w: f32::NAN, due: false, row, ready }
}

/// Quality of the forecast after a sample without a reading, as determined by the sample.
fn quality_unread(
    required: RequiredInputs,
    pending: &Pending,
    window: &Window,
    ready: bool,
) -> (u16, u16) {
    match (window.is_full(), ready) {
        (false, _) => Quality::Invalid(InvalidReason::NoReading).encode(),
        (true, false) => missing(required, pending),
        (true, true) => {
            let steps = window.unread_steps;
            Quality::OpenLoop { steps }.encode()
        }
    }
}

block! {
    /// The result of one sample.
    #[derive(Clone, Copy)]
    pub(crate) struct Step: NONE;

    /// [`Step`]s of a block.
    #[derive(Clone, Copy)]
    pub(crate) struct StepLanes {
        /// The one-step-ahead forecast of its reading, W. NaN if there was none.
        pub expected_w: f32 = f32::NAN,
        /// True if a new measurement was due with it.
        pub due: bool = false,
        /// Row of the next forecast, if it is `ready`.
        pub row: [f32; INPUTS] = [0.0; INPUTS],
        pub ready: bool = false,
    }
}

/// Takes a sample with a reading, `after` the previous one's command and that time, s. `forecast_w`
/// is its forecast, one step ahead if `exact`.
#[inline(always)]
pub(crate) fn read(
    required: RequiredInputs,
    window: &mut Window,
    pending: &Pending,
    (forecast_w, exact): (f32, bool),
    after: ((f32, f32), f32),
) -> Step {
    // Only forecasts one step ahead are scored: the ones over a gap are of another kind.
    let one_step = exact & window.is_scored();
    let due = window.due();
    window.read(pending.power_w, !pending.has(sample_flag::HELD));
    let (row, ready) = window.next_row(after, pending.command(), required);
    Step { expected_w: if one_step { forecast_w } else { f32::NAN }, due, row, ready }
}

#[inline(always)]
pub(crate) fn seconds(elapsed_ns: u64) -> f32 {
    (elapsed_ns as f64 * 1e-9) as f32
}

/// Quality of the forecast after a sample with a reading, as determined by the sample. `have`:
/// readings in the window.
#[inline(always)]
pub(crate) fn quality(
    required: RequiredInputs,
    pending: &Pending,
    have: u8,
    ready: bool,
) -> (u16, u16) {
    const FRESH: (u16, u16) = Quality::Fresh.encode();
    const HELD: (u16, u16) = Quality::Held.encode();
    const WARMUP: (u16, u16) = Quality::Warmup { have: 0 }.encode();
    let held = pending.has(sample_flag::HELD);
    let fresh = if held { HELD } else { FRESH };
    let missing = missing(required, pending);
    let full = if ready { fresh } else { missing };
    if usize::from(have) == LAGS { full } else { (WARMUP.0, have.into()) }
}

/// Reason that a full window yields no row.
#[inline(always)]
fn missing(required: RequiredInputs, pending: &Pending) -> (u16, u16) {
    const COMMAND: (u16, u16) = Quality::Invalid(InvalidReason::NoCommand).encode();
    const FRESHNESS: (u16, u16) = Quality::Invalid(InvalidReason::NoFreshness).encode();
    if required.command & pending.command().is_none() { COMMAND } else { FRESHNESS }
}
