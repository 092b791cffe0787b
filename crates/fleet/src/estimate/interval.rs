//! Prediction intervals with guaranteed coverage: adaptive conformal inference on residuals that
//! are centred and scaled by the recent ones.
//!
//! An end lies at the recent mean of the residuals plus their recent mean size times a factor of
//! its own. The factor grows when a reading falls outside that end, and shrinks otherwise, by so
//! much less that in the long run the nominal share of readings lies inside, for any residuals
//! (Angelopoulos, Candès, Tibshirani, "Conformal PID control", 2023, section 2: quantile tracking
//! with an adaptive scale). Since it changes by constant ratios, after `n` readings
//!
//! ```text
//! |missed − tail·n|  ≤  |ln(factor now / factor at the start)| / rate
//! ```
//!
//! holds exactly, for any residuals, while the factor stays inside its bounds: at a rate of 0.2 a
//! factor that has doubled corresponds to 3.5 readings.
//!
//! The residual of a held reading is nearly zero; that of a new measurement is not. Mean and size
//! are therefore kept separately for the two cases; the factors, and with them the coverage, are
//! common to all readings.

use joulebus_settings::IntervalSettings;
use serde::{Deserialize, Serialize};

use crate::layout::lanes::{block, put};

/// Weight of the newest residual in their mean and size, and in the recent coverage.
const RECENT_WEIGHT: f32 = 0.01;
const COVERAGE_WEIGHT: f32 = 0.005;
/// Weight of the initial size, in residuals.
const TRUST: f32 = 5.0;
/// Bounds of a factor.
const FACTOR: (f32, f32) = (1e-3, 1e3);
/// Limit of residuals, W.
const RESIDUAL_MAX: f32 = 1e6;

/// Ratios by which the factors change.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct QuantileStep {
    /// For an end that was exceeded. Above 1.
    grow: f32,
    /// For an end that was not. Below 1.
    shrink: f32,
}

impl QuantileStep {
    pub(crate) fn new(settings: &IntervalSettings) -> Self {
        let tail = 0.5 * (1.0 - settings.coverage);
        Self {
            grow: libm::expf(settings.rate * (1.0 - tail)),
            shrink: libm::expf(-settings.rate * tail),
        }
    }
}

/// The interval of one robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ConformalInterval {
    /// Distance of each end from the mean, in sizes.
    below: f32,
    above: f32,
    /// Recent mean of the residuals, W: where a new measurement is due (or due is unknown), and
    /// where none is.
    mean_due_w: f32,
    mean_held_w: f32,
    /// Recent mean distance from it, W.
    size_due_w: f32,
    size_held_w: f32,
    covered: u64,
    recent: f32,
    /// Number of residuals so far, saturating at 255.
    seen_due: u8,
    seen_held: u8,
}

impl ConformalInterval {
    /// From the model's residual quantiles (5 % and 95 %) and the lower bound of any scale, W.
    pub(crate) fn new(q05_w: f32, q95_w: f32, floor_w: f32, coverage: f32) -> Self {
        // Half of the distance between the quantiles is two mean sizes of a normal distribution.
        let size_w = (0.25 * (q95_w - q05_w)).max(floor_w).max(f32::MIN_POSITIVE);
        let factor = |end_w: f32| (end_w / size_w).clamp(FACTOR.0, FACTOR.1);
        Self {
            below: factor(-q05_w),
            above: factor(q95_w),
            mean_due_w: 0.0,
            mean_held_w: 0.0,
            size_due_w: size_w,
            size_held_w: size_w,
            covered: 0,
            recent: coverage,
            seen_due: 0,
            seen_held: 0,
        }
    }

    /// Records a residual (finite), counts whether it was covered, and adapts the ends; `due`:
    /// whether a new measurement was due.
    #[inline(always)]
    pub(crate) fn observe(
        &mut self,
        residual_w: f32,
        due: bool,
        floor_w: f32,
        quantile_step: QuantileStep,
    ) {
        let (mean_w, size_w) = self.phase_w(due);
        let over = residual_w > mean_w + size_w * self.above;
        let under = residual_w < mean_w - size_w * self.below;
        let covered = !(over | under);
        self.covered += u64::from(covered);
        self.recent += COVERAGE_WEIGHT * (if covered { 1.0 } else { 0.0 } - self.recent);
        let moved = |factor: f32, missed: bool| {
            let by = if missed {
                quantile_step.grow
            } else {
                quantile_step.shrink
            };
            (factor * by).clamp(FACTOR.0, FACTOR.1)
        };
        (self.above, self.below) = (moved(self.above, over), moved(self.below, under));
        let apart_w = (residual_w.clamp(-RESIDUAL_MAX, RESIDUAL_MAX)) - mean_w;
        // The initial size is forgotten quickly, the initial mean is not: it is 0, unless the model
        // has a bias that one robot's first readings do not show.
        let seen = if due { self.seen_due } else { self.seen_held };
        let weight = RECENT_WEIGHT.max(1.0 / (1.0 + TRUST + f32::from(seen)));
        let size_w = (size_w + weight * (apart_w.abs() - size_w)).max(floor_w);
        let (mean_w, seen) = (mean_w + RECENT_WEIGHT * apart_w, seen.saturating_add(1));
        put(&mut self.size_due_w, due, size_w);
        put(&mut self.size_held_w, !due, size_w);
        put(&mut self.mean_due_w, due, mean_w);
        put(&mut self.mean_held_w, !due, mean_w);
        put(&mut self.seen_due, due, seen);
        put(&mut self.seen_held, !due, seen);
    }

    /// Mean and size of the residuals where a new measurement is due, or where none is, W.
    #[inline(always)]
    fn phase_w(&self, due: bool) -> (f32, f32) {
        (
            if due {
                self.mean_due_w
            } else {
                self.mean_held_w
            },
            if due {
                self.size_due_w
            } else {
                self.size_held_w
            },
        )
    }

    /// Share of the `observed` readings inside, over all and recently; NaN before the first.
    #[inline(always)]
    pub(crate) fn coverage(&self, observed: u64) -> (f32, f32) {
        let over_all = (self.covered as f64 / observed as f64) as f32;
        let recent = if observed > 0 { self.recent } else { f32::NAN };
        (if observed > 0 { over_all } else { f32::NAN }, recent)
    }

    /// The interval around `forecast_w`, `open_steps` sample periods after the last reading: it
    /// widens with the square root of the steps, like a random walk. `due`: whether a new
    /// measurement is due.
    #[inline(always)]
    pub(crate) fn around(&self, forecast_w: f32, open_steps: u16, due: bool) -> (f32, f32) {
        let (mean_w, size_w) = self.phase_w(due);
        let middle_w = forecast_w + mean_w;
        let size_w = size_w * (1.0 + f32::from(open_steps)).sqrt();
        (
            middle_w - size_w * self.below,
            middle_w + size_w * self.above,
        )
    }
}

block! {
    /// The intervals of a block.
    #[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
    #[repr(align(32))]
    pub(crate) struct IntervalLanes of ConformalInterval {
        below: f32,
        above: f32,
        mean_due_w: f32,
        mean_held_w: f32,
        size_due_w: f32,
        size_held_w: f32,
        recent: f32,
        covered: u64,
        seen_due: u8,
        seen_held: u8,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const SETTINGS: IntervalSettings = IntervalSettings {
        coverage: 0.9,
        rate: 0.2,
    };

    proptest! {
        #[test]
        fn coverage_is_held_whatever_the_scale_and_the_shift(
            scale in 0.01f32..100.0, shift in -2.0f32..2.0, seed in any::<u32>()
        ) {
            let mut interval = ConformalInterval::new(-1.0, 1.0, 0.01, 0.9);
            let (mut state, quantile_step) = (u64::from(seed) | 1, QuantileStep::new(&SETTINGS));
            for step in 0..4_000 {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                let uniform = (state >> 40) as f32 / (1 << 24) as f32 - 0.5;
                let drift = if step > 2_000 { shift } else { 0.0 };
                interval.observe(scale * (uniform + drift), true, 0.0, quantile_step);
            }
            let (all, recent) = interval.coverage(4_000);
            prop_assert!((0.885..=0.915).contains(&all), "{all}");
            prop_assert!((0.8..=0.98).contains(&recent), "{recent}");
        }

        /// The bound in the module's documentation, for arbitrary residuals.
        #[test]
        fn misses_are_bounded_by_how_far_the_factor_has_moved(
            residuals in prop::collection::vec((-1e3f32..1e3, -9i32..3, any::<bool>()), 1..600),
        ) {
            let mut interval = ConformalInterval::new(-1.0, 1.0, 1e-9, 0.9);
            let quantile_step = QuantileStep::new(&SETTINGS);
            let (mut missed, mut observed) = (0.0, 0.0);
            for (value, exponent, due) in residuals {
                let before = interval;
                let residual_w = value * 10f32.powi(exponent);
                interval.observe(residual_w, due, 1e-9, quantile_step);
                if interval.above <= FACTOR.0 || interval.above >= FACTOR.1 {
                    break;
                }
                let (_, hi_w) = before.around(0.0, 0, due);
                missed += if residual_w > hi_w { 1.0 } else { 0.0 };
                observed += 1.0;
            }
            let moved = (interval.above / 2.0).ln() / SETTINGS.rate;
            prop_assert!((missed - 0.05 * observed - moved).abs() < 0.01 + 1e-3 * observed, "{missed} of {observed}");
        }
    }

    #[test]
    fn the_interval_contains_its_forecast_and_widens_open_loop() {
        let interval = ConformalInterval::new(-0.05, 0.05, 0.01, 0.9);
        let (mut lo, mut hi) = interval.around(3.6, 0, true);
        assert!(lo < 3.6 && 3.6 < hi);
        for steps in 1..30 {
            let wider = interval.around(3.6, steps, true);
            assert!(wider.0 < lo && wider.1 > hi);
            (lo, hi) = wider;
        }
    }

    #[test]
    fn held_readings_have_a_separate_interval() {
        let mut interval = ConformalInterval::new(-0.2, 0.2, 0.001, 0.9);
        let quantile_step = QuantileStep::new(&SETTINGS);
        for step in 0..3_000u32 {
            let due = step % 3 == 0;
            let size_w = if due { 0.2 } else { 0.002 };
            interval.observe(
                size_w * (step as f32 * 1.7).sin(),
                due,
                0.001,
                quantile_step,
            );
        }
        let width_w = |due| {
            let (lo_w, hi_w) = interval.around(0.0, 0, due);
            hi_w - lo_w
        };
        assert!(width_w(true) > 30.0 * width_w(false), "{interval:?}");
        let (all, _) = interval.coverage(3_000);
        assert!((0.89..=0.91).contains(&all), "{all}");
    }
}
