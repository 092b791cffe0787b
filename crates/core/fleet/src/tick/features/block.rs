//! The common case, sixteen robots at a time: samples with readings that follow the last ones
//! without a gap. Uses the functions of [`super::step`].

// Indexed by lane, so that the compiler vectorises the loop.
#![allow(clippy::needless_range_loop)]

use joulebus_predictor::LAGS;
use joulebus_wire::sample_flag;

use crate::estimate::energy::{EnergyLanes, EnergySamples};
use crate::estimate::interval::IntervalLanes;
use crate::estimate::online::{Members, OnlineLanes, RlsUpdate, RlsUpdateLanes};
use crate::estimate::window::{ClosedLanes, Gap, RequiredInputs, WindowLanes};
use crate::ingest::last_sample::LastLanes;
use crate::ingest::pending::{PendingBlock, PendingLanes, PendingState};
use crate::layout::lanes::{Block as _, LANES, Lanes, put};
use crate::state::columns::ColumnsMut;
use crate::tick::batch::Batch;
use crate::tick::features::step::{Step, StepLanes, quality, read, seconds};
use crate::tick::platform_context::PlatformContext;

/// Samples that follow the last ones of their robots without a gap, with readings.
#[derive(Clone, Copy)]
pub(crate) struct InSequence<'a> {
    /// Lanes with such a sample.
    pub mask: &'a Lanes<bool>,
    /// Time since the previous sample, ns.
    pub elapsed_ns: &'a Lanes<u64>,
}

/// Takes the samples in sequence of a block, and adds the rows for the next forecasts.
///
/// What loops read beside the columns that they write is copied first. The copies are small, and
/// the compiler knows that no write changes them: otherwise it would not vectorise the loops.
#[inline(always)]
pub(crate) fn step_block(
    context: &PlatformContext,
    columns: &mut ColumnsMut<'_>,
    block: usize,
    next: &InSequence<'_>,
    batch: &mut Batch,
) {
    let (first, mask) = (block * LANES, *next.mask);
    let samples = columns.pending[block].samples;
    let windows = &mut columns.windows[block];
    let (lasts, intervals) = (&mut columns.lasts[block], &mut columns.intervals[block]);
    // Every lane is computed, and the mask selects those that are stored: a branch for each lane
    // would keep the loops from being vectorised.
    let (mut elapsed_s, mut forecast_w) = ([0.0; LANES], [0.0; LANES]);
    for lane in 0..LANES {
        elapsed_s[lane] = seconds(next.elapsed_ns[lane]);
        forecast_w[lane] = windows.get(lane).close(Gap::None);
    }
    // The residual is that of the network's own forecast, whatever was published.
    let mut network_w = forecast_w;
    if let Some(members) = &context.members {
        let online = &mut columns.online[block];
        for lane in 0..LANES {
            let known = !forecast_w[lane].is_nan();
            put(&mut network_w[lane], known, online.network_w[lane]);
        }
        learn(members, online, &windows.closed, &samples, mask);
        // Once in a robot's life, so this loop may branch.
        for lane in (0..LANES).filter(|lane| mask[*lane] & online.has_started(*lane)) {
            if let Some(shown) = online.get(lane).shown_start(members) {
                context.errors.show(columns.admissions[first + lane].id, &shown);
            }
        }
    }
    read_lasts(lasts, &samples, mask, &elapsed_s, &network_w);
    let mut steps = const { StepLanes::all(&Step::NONE) };
    let energy = &mut columns.energy[block];
    let mut before = [(0.0, 0.0); LANES];
    for lane in 0..LANES {
        (before[lane], _) = energy.command(lane);
    }
    let after = (&before, &elapsed_s);
    read_windows(context.required, &mut windows.closed, &samples, mask, after, &mut steps);
    qualify(context.required, lasts, &samples, mask, windows, &steps);
    store_expected(&mut columns.pending[block], mask, &steps);
    adapt_intervals(context, intervals, &samples, &steps);
    let admissions = &columns.admissions[first..first + LANES];
    let levels = &columns.levels[block];
    observe_energy(context, energy, &samples, mask, &elapsed_s, |lane| {
        (admissions[lane].id, levels.get(lane).shown())
    });
    // Admissions are stored by robot, not by lane, so this loop may branch.
    for lane in (0..LANES).filter(|lane| mask[*lane]) {
        columns.admissions[first + lane].accept(&samples.get(lane));
    }
    batch.push_block(first, &steps.ready, &steps.row);
}

/// Learns the readings of a block, before they become part of the windows.
#[inline(always)]
fn learn(
    members: &Members,
    online: &mut OnlineLanes,
    windows: &ClosedLanes,
    samples: &PendingLanes,
    mask: Lanes<bool>,
) {
    let members = *members;
    let mut lags_w = [[0.0; LANES]; LAGS];
    let (mut last_w, mut due) = ([0.0; LANES], [false; LANES]);
    let mut scored = [false; LANES];
    for lane in 0..LANES {
        let window = windows.get(lane);
        let lag_w = window.lags_w();
        for lag in 0..LAGS {
            lags_w[lag][lane] = lag_w[lag];
        }
        (last_w[lane], due[lane]) = (window.last_w(), window.due());
        scored[lane] = mask[lane] & window.is_scored();
    }
    let mut updates = const { RlsUpdateLanes::all(&RlsUpdate::NONE) };
    // A copy: in place, this loop is not vectorised.
    let before = *online;
    for lane in 0..LANES {
        let [a, b, c, d, e] = &lags_w;
        let lag_w = [a[lane], b[lane], c[lane], d[lane], e[lane]];
        let mut robot = before.get(lane);
        let update = robot.update_weights(&members, &lag_w, due[lane], samples.power_w[lane]);
        updates.set(lane, true, update);
        online.set_losses(lane, scored[lane], &robot);
    }
    online.judge(&scored, &updates);
    for lane in 0..LANES {
        let mut robot = online.get(lane);
        robot.update_rls(&updates.get(lane));
        online.set_stacks(lane, scored[lane], &robot);
    }
    // All readings count for the sizes, also those whose window cannot be scored.
    for lane in 0..LANES {
        let mut robot = online.get(lane);
        robot.read(&members, last_w[lane], due[lane], samples.power_w[lane]);
        online.set_sizes(lane, mask[lane], &robot);
    }
}

/// Advances the energy states of a block.
#[inline(always)]
fn observe_energy(
    context: &PlatformContext,
    energy: &mut EnergyLanes,
    samples: &PendingLanes,
    mask: Lanes<bool>,
    elapsed_s: &Lanes<f32>,
    robot: impl Fn(usize) -> (u32, Option<f32>),
) {
    let (mut v_mps, mut omega_radps) = ([f32::NAN; LANES], [f32::NAN; LANES]);
    let (mut working_s, mut charging) = (*elapsed_s, [false; LANES]);
    for lane in 0..LANES {
        let sample = samples.get(lane);
        charging[lane] = sample.has(sample_flag::CHARGING);
        // On the charger a robot draws other power than at work. Its levels wait, unless they are
        // still unknown.
        put(&mut working_s[lane], charging[lane] & energy.is_settled(lane), 0.0);
        let command = sample.command();
        put(&mut v_mps[lane], command.is_some(), sample.v_mps);
        put(&mut omega_radps[lane], command.is_some(), sample.omega_radps);
    }
    let samples = EnergySamples {
        power_w: &samples.power_w,
        elapsed_s: &working_s,
        v_mps: &v_mps,
        omega_radps: &omega_radps,
        charging: &charging,
    };
    energy.observe(&context.energy, context.learned_errors(), &mask, &samples, robot);
}

/// Replaces the last samples of a block by the next.
#[inline(always)]
fn read_lasts(
    lasts: &mut LastLanes,
    samples: &PendingLanes,
    mask: Lanes<bool>,
    elapsed_s: &Lanes<f32>,
    forecast_w: &Lanes<f32>,
) {
    for lane in 0..LANES {
        let mut last = lasts.get(lane);
        let sample = samples.get(lane);
        last.seq = sample.seq;
        last.read(&sample, forecast_w[lane], elapsed_s[lane]);
        lasts.set(lane, mask[lane], last);
    }
}

/// Advances the windows of a block by their readings and commands.
#[inline(always)]
fn read_windows(
    required: RequiredInputs,
    windows: &mut ClosedLanes,
    samples: &PendingLanes,
    mask: Lanes<bool>,
    (before, elapsed_s): (&Lanes<(f32, f32)>, &Lanes<f32>),
    steps: &mut StepLanes,
) {
    // A copy: in place, this loop is not vectorised.
    let mut copy = *windows;
    for lane in 0..LANES {
        let mut window = copy.get(lane);
        let forecast_w = (window.close(Gap::None), true);
        let after = (before[lane], elapsed_s[lane]);
        let step = read(required, &mut window, &samples.get(lane), forecast_w, after);
        copy.put(lane, mask[lane], &window);
        let expected_w = if mask[lane] { step.expected_w } else { f32::NAN };
        steps.set(lane, true, Step { expected_w, ready: mask[lane] & step.ready, ..step });
    }
    *windows = copy;
}

/// Sets the quality of the forecasts of a block.
#[inline(always)]
fn qualify(
    required: RequiredInputs,
    lasts: &mut LastLanes,
    samples: &PendingLanes,
    mask: Lanes<bool>,
    windows: &WindowLanes,
    steps: &StepLanes,
) {
    for lane in 0..LANES {
        let (sample, have) = (samples.get(lane), windows.have(lane));
        let quality = quality(required, &sample, have, steps.ready[lane]);
        lasts.set_quality(lane, mask[lane], quality);
    }
}

/// Stores the forecasts of a block's readings.
#[inline(always)]
fn store_expected(pending: &mut PendingBlock, mask: Lanes<bool>, steps: &StepLanes) {
    for lane in 0..LANES {
        pending.mark(lane, mask[lane], PendingState::Absorbed);
        put(&mut pending.expected_w[lane], mask[lane], steps.expected_w[lane]);
    }
}

/// Adapts the intervals of a block to the residuals.
#[inline(always)]
fn adapt_intervals(
    context: &PlatformContext,
    intervals: &mut IntervalLanes,
    samples: &PendingLanes,
    steps: &StepLanes,
) {
    let (floor_w, quantile_step) = (context.platform.power_resolution_w, context.quantile_step);
    for lane in 0..LANES {
        let mut interval = intervals.get(lane);
        let residual_w = samples.power_w[lane] - steps.expected_w[lane];
        interval.observe(residual_w, steps.due[lane], floor_w, quantile_step);
        intervals.set(lane, !steps.expected_w[lane].is_nan(), interval);
    }
}
