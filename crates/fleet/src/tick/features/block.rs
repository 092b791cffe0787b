//! What the next samples of a block's robots do to them: as [`crate::tick::features::step`], sixteen at a time.

// Lanes are counted: that is the loop that the compiler makes vectors of.
#![allow(clippy::needless_range_loop)]

use joulebus_predictor::INPUTS;

use crate::estimate::interval::IntervalLanes;
use crate::estimate::window::{ClosedLanes, Gap, Reads, WindowLanes};
use crate::ingest::robot::{LastLanes, PendingBlock, PendingState};
use crate::layout::lanes::{Block as _, LANES, Lanes, put};
use crate::state::columns::ColumnsMut;
use crate::tick::batch::Batch;
use crate::tick::features::step::{Step, quality, read, seconds};
use crate::tick::platform_context::PlatformContext;

/// Samples that are the next of their robots, with readings.
#[derive(Clone, Copy)]
pub(crate) struct Next<'a> {
    /// Whose.
    pub which: &'a Lanes<bool>,
    /// Time since the sample before, ns.
    pub elapsed_ns: &'a Lanes<u64>,
}

/// Takes such samples of a block, and adds the rows for the next forecasts.
#[inline(always)]
pub(crate) fn step_block(
    context: &PlatformContext,
    columns: &mut ColumnsMut<'_>,
    block: usize,
    next: &Next<'_>,
    batch: &mut Batch,
) {
    let (pending, windows) = (&mut columns.pending[block], &mut columns.windows[block]);
    let (lasts, intervals) = (&mut columns.lasts[block], &mut columns.intervals[block]);
    let (first, which) = (block * LANES, next.which);
    let (mut elapsed_s, mut forecast_w) = ([0.0; LANES], [0.0; LANES]);
    for lane in 0..LANES {
        elapsed_s[lane] = seconds(next.elapsed_ns[lane]);
        forecast_w[lane] = windows.get(lane).close(Gap::None);
    }
    read_lasts(lasts, pending, which, &elapsed_s, &forecast_w);
    let mut taken = Taken::NONE;
    let closed = &mut windows.closed;
    read_windows(
        context.reads,
        closed,
        pending,
        which,
        &elapsed_s,
        &mut taken,
    );
    qualify(context.reads, lasts, pending, which, windows, &taken);
    expect(pending, which, &taken);
    follow(context, intervals, pending, &taken);
    for lane in (0..LANES).filter(|lane| which[*lane]) {
        columns.admissions[first + lane].accept(&pending.samples.get(lane));
    }
    if let Some(blending) = &context.blending {
        for lane in (0..LANES).filter(|lane| taken.scored[*lane]) {
            columns.blends[first + lane].learn(blending, pending.samples.power_w[lane]);
        }
    }
    batch.push_block(first, &taken.ready, &taken.rows);
}

/// Has the last samples of a block replaced by the next.
#[inline(always)]
fn read_lasts(
    lasts: &mut LastLanes,
    pending: &PendingBlock,
    which: &Lanes<bool>,
    elapsed_s: &Lanes<f32>,
    forecast_w: &Lanes<f32>,
) {
    // A copy, so that the compiler sees that nothing else writes to it.
    let mut its = *lasts;
    for lane in 0..LANES {
        let mut last = its.get(lane);
        let pending = pending.samples.get(lane);
        last.seq = pending.seq;
        last.read(&pending, forecast_w[lane], elapsed_s[lane]);
        its.set(lane, which[lane], last);
    }
    *lasts = its;
}

/// Has the windows of a block take their readings and commands.
#[inline(always)]
fn read_windows(
    reads: Reads,
    windows: &mut ClosedLanes,
    pending: &PendingBlock,
    which: &Lanes<bool>,
    elapsed_s: &Lanes<f32>,
    taken: &mut Taken,
) {
    // A copy, so that the compiler sees that nothing else writes to it.
    let mut its = *windows;
    for lane in 0..LANES {
        let mut window = its.get(lane);
        let forecast_w = (window.close(Gap::None), true);
        let pending = pending.samples.get(lane);
        let step = read(reads, &mut window, &pending, forecast_w, elapsed_s[lane]);
        its.put(lane, which[lane], &window);
        taken.set(lane, which[lane], &step);
    }
    *windows = its;
}

/// Notes what the forecasts of a block may be called.
#[inline(always)]
fn qualify(
    reads: Reads,
    lasts: &mut LastLanes,
    pending: &PendingBlock,
    which: &Lanes<bool>,
    windows: &WindowLanes,
    taken: &Taken,
) {
    for lane in 0..LANES {
        let (pending, have) = (pending.samples.get(lane), windows.have(lane));
        let quality = quality(reads, &pending, have, taken.ready[lane]);
        lasts.set_quality(lane, which[lane], quality);
    }
}

/// Notes what was expected of the readings of a block.
#[inline(always)]
fn expect(pending: &mut PendingBlock, which: &Lanes<bool>, taken: &Taken) {
    for lane in 0..LANES {
        pending.mark(lane, which[lane], PendingState::Absorbed);
        put(
            &mut pending.expected_w[lane],
            which[lane],
            taken.expected_w[lane],
        );
    }
}

/// QuantileStep the intervals of a block on by the residuals.
#[inline(always)]
fn follow(
    context: &PlatformContext,
    intervals: &mut IntervalLanes,
    pending: &PendingBlock,
    taken: &Taken,
) {
    let (floor_w, quantile_step) = (context.platform.power_resolution_w, context.quantile_step);
    // A copy, so that the compiler sees that nothing else writes to it.
    let mut its = *intervals;
    for lane in 0..LANES {
        let mut interval = its.get(lane);
        let residual_w = pending.samples.power_w[lane] - taken.expected_w[lane];
        interval.observe(residual_w, taken.due[lane], floor_w, quantile_step);
        its.set(lane, taken.scored[lane], interval);
    }
    *intervals = its;
}

/// [`Step`]s of a block.
struct Taken {
    expected_w: Lanes<f32>,
    /// Whether there was such a forecast.
    scored: Lanes<bool>,
    due: Lanes<bool>,
    ready: Lanes<bool>,
    rows: [Lanes<f32>; INPUTS],
}

impl Taken {
    const NONE: Self = Self {
        expected_w: [f32::NAN; LANES],
        scored: [false; LANES],
        due: [false; LANES],
        ready: [false; LANES],
        rows: [[0.0; LANES]; INPUTS],
    };

    #[inline(always)]
    fn set(&mut self, lane: usize, which: bool, step: &Step) {
        self.expected_w[lane] = step.expected_w;
        self.scored[lane] = which & !step.expected_w.is_nan();
        self.due[lane] = step.due;
        self.ready[lane] = which & step.ready;
        for feature in 0..INPUTS {
            self.rows[feature][lane] = step.row[feature];
        }
    }
}
