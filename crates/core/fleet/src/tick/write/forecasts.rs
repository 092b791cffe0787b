//! Forecasts.

use joulebus_predictor::nan::canonical;
use joulebus_wire::{Forecast, InvalidReason, Quality, forecast_flag};

use crate::ingest::admission::AdmissionState;
use crate::layout::lanes::{self, Block as _, LANES, Lanes};
use crate::state::columns::BlockRef;
use crate::tick::context::TickContext;
use crate::tick::write::flag::flag;

/// The forecasts of a block.
pub(crate) struct ForecastRows<'a> {
    block: BlockRef<'a>,
    power_w: Lanes<f32>,
    open_steps: Lanes<u16>,
    lo_w: Lanes<f32>,
    hi_w: Lanes<f32>,
    /// True if it is a forecast from a reading, as far as the time does not matter.
    plain: Lanes<bool>,
}

impl<'a> ForecastRows<'a> {
    #[inline(always)]
    pub(crate) fn new(block: BlockRef<'a>) -> Self {
        let (mut power_w, mut open_steps) = ([0.0; LANES], [0; LANES]);
        let mut due = [false; LANES];
        for lane in 0..LANES {
            (power_w[lane], open_steps[lane]) = block.windows.get(lane).shown();
        }
        let mut open = [false; LANES];
        for lane in 0..LANES {
            due[lane] = block.windows.get(lane).due();
            open[lane] = block.windows.is_open(lane);
        }
        if lanes::any(&open) {
            for lane in (0..LANES).filter(|lane| open[*lane]) {
                due[lane] = block.windows.get(lane).shown_due();
            }
        }
        let (mut lo_w, mut hi_w) = ([0.0; LANES], [0.0; LANES]);
        for lane in 0..LANES {
            let interval = block.intervals.get(lane);
            let ends_w = interval.around(power_w[lane], open_steps[lane], due[lane]);
            (lo_w[lane], hi_w[lane]) = ends_w;
        }
        let mut plain = [false; LANES];
        for lane in 0..LANES {
            let (code, _) = block.lasts.quality(lane);
            plain[lane] = is_read(code) & power_w[lane].is_finite() & (open_steps[lane] == 0);
        }
        Self { block, power_w, open_steps, lo_w, hi_w, plain }
    }

    /// The forecast of the robot in a lane.
    #[inline(always)]
    pub(crate) fn get(&self, tick: &TickContext, lane: usize) -> Forecast {
        let (admission, last) = (&self.block.admissions[lane], self.block.lasts.get(lane));
        let platform = &tick.platforms[usize::from(admission.platform)].platform;
        let now = self.plain[lane] & admission.invalid.is_none() & !tick.is_stale(admission);
        let (known, (quality, quality_detail), ahead) = if now {
            (true, (last.quality, last.quality_detail), 1)
        } else {
            self.otherwise(tick, lane)
        };
        let watts = |value: f32| canonical(if known { value } else { f32::NAN });
        Forecast {
            robot: admission.id,
            flags: flag(known, forecast_flag::POWER | forecast_flag::INTERVAL)
                | flag(!last.reading_w.is_nan(), forecast_flag::READING)
                | flag(admission.accepted, forecast_flag::SAMPLE),
            quality,
            quality_detail,
            reading_w: canonical(last.reading_w),
            power_w: watts(self.power_w[lane]),
            lo_w: watts(self.lo_w[lane]),
            hi_w: watts(self.hi_w[lane]),
            generation: admission.generation,
            sample_seq: last.seq,
            stamp_ns: admission.stamp_ns,
            target_ns: admission.stamp_ns.saturating_add(ahead * platform.period_ns),
            reading_age_ns: admission.stamp_ns.saturating_sub(last.measured_ns),
            source_epoch: admission.source_epoch,
        }
    }

    /// For a robot whose forecast is not from a reading, or missing: whether there is one, its
    /// quality, and how many sample periods it is ahead.
    #[cold]
    #[inline(never)]
    fn otherwise(&self, tick: &TickContext, lane: usize) -> (bool, (u16, u16), u64) {
        let (code, detail) = self.block.lasts.quality(lane);
        let (power_w, open_steps) = (self.power_w[lane], self.open_steps[lane]);
        let made = Quality::decode(code, detail);
        let quality = quality_now(tick, &self.block.admissions[lane], made, power_w, open_steps);
        let known = matches!(quality, Quality::Fresh | Quality::Held | Quality::OpenLoop { .. });
        // A robot in open loop by the worker's clock is forecast further ahead.
        let read_steps = self.block.windows.get(lane).unread_steps;
        let ahead = 1 + u64::from(open_steps.saturating_sub(read_steps));
        (known, quality.encode(), ahead)
    }
}

const FRESH: u16 = Quality::Fresh.encode().0;
const HELD: u16 = Quality::Held.encode().0;

/// True if the code belongs to a forecast from a reading.
#[inline(always)]
const fn is_read(code: u16) -> bool {
    (code == FRESH) | (code == HELD)
}

/// The quality of the robot in a lane at the time of the tick, encoded, given the forecast that is
/// shown.
#[inline(always)]
pub(super) fn quality_of(
    tick: &TickContext,
    block: &BlockRef<'_>,
    lane: usize,
    (power_w, open_steps): (f32, u16),
) -> (u16, u16) {
    let (admission, made) = (&block.admissions[lane], block.lasts.quality(lane));
    let plain = is_read(made.0) & power_w.is_finite() & (open_steps == 0);
    let now = plain & admission.invalid.is_none() & !tick.is_stale(admission);
    if now { made } else { otherwise(tick, admission, made, (power_w, open_steps)) }
}

/// The quality of a robot whose last sample had no reading, or that is overdue or invalid.
#[cold]
#[inline(never)]
fn otherwise(
    tick: &TickContext,
    admission: &AdmissionState,
    (code, detail): (u16, u16),
    (power_w, open_steps): (f32, u16),
) -> (u16, u16) {
    quality_now(tick, admission, Quality::decode(code, detail), power_w, open_steps).encode()
}

/// The quality of the output at the time of the tick. `quality`: as of the robot's last sample.
fn quality_now(
    tick: &TickContext,
    admission: &AdmissionState,
    quality: Quality,
    power_w: f32,
    open_steps: u16,
) -> Quality {
    if tick.is_stale(admission) {
        return Quality::Invalid(InvalidReason::Stale);
    }
    if let Some(reason) = admission.invalid {
        return Quality::Invalid(reason);
    }
    match quality {
        quality @ (Quality::Warmup { .. } | Quality::Invalid(_) | Quality::Unknown) => quality,
        _ if !power_w.is_finite() => Quality::Invalid(InvalidReason::ModelOutput),
        _ if open_steps > 0 => Quality::OpenLoop { steps: open_steps },
        quality => quality,
    }
}
