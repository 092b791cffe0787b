//! Intervals that hold their coverage: adaptive conformal inference on residuals scaled by the
//! recent ones.
//!
//! An end lies at the forecast plus or minus the recent mean size of the residuals times a factor
//! of its own, so a forecast always lies inside its interval. The factor grows whenever a reading
//! falls outside that end, and shrinks by so much less otherwise that in the long run the wanted
//! fraction of readings lies inside, whatever the residuals do (Angelopoulos, Candès, Tibshirani,
//! "Conformal PID control", 2023, section 2: quantile tracking and a scale that follows). Since it
//! moves in equal ratios, after `n` readings
//!
//! ```text
//! |missed − tail·n|  ≤  |ln(factor now / factor at the start)| / rate
//! ```
//!
//! holds exactly, for any residuals, as long as both factors stay inside their bounds: at a rate of
//! 0.2 a factor that has doubled has cost 3.5 readings. Where residuals have one sign only, one
//! factor reaches its lower bound. The other end then answers for both tails.
//!
//! Where a reading is held, its residual is next to nothing. Where a new measurement is due, it is
//! not. Sizes and factors are kept separately, so that coverage holds among either.

use joulebus_settings::IntervalSettings;
use serde::{Deserialize, Serialize};

use crate::layout::lanes::{Count, block, put};

/// Weight of the newest residual in their mean and size, and in the recent coverage.
const RECENT_WEIGHT: f32 = 0.01;
const COVERAGE_WEIGHT: f32 = 0.005;
/// Weight of the initial size, in residuals.
const TRUST: f32 = 5.0;
/// Bounds of a factor.
const FACTOR: (f32, f32) = (1e-3, 1e3);
/// Minimum size for held readings, as a share of that for due ones, because no resolution limits
/// it.
const HELD_FLOOR: f32 = 0.01;
/// Largest residual that is believed, W.
const MAX_RESIDUAL_W: f32 = 1e6;

/// Ratios by which the factors change.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct QuantileStep {
    /// With one tail for each end.
    each: EndStep,
    /// Ratios of an end that answers for both.
    both: EndStep,
}

/// Factors that multiply an end's factor.
#[derive(Debug, Clone, Copy, PartialEq)]
struct EndStep {
    /// Factor after a miss. Above 1.
    grow: f32,
    /// Factor after a hit. Below 1.
    shrink: f32,
}

impl QuantileStep {
    pub(crate) fn new(settings: &IntervalSettings) -> Self {
        let step = |tail: f32| EndStep {
            grow: libm::expf(settings.rate * (1.0 - tail)),
            shrink: libm::expf(-settings.rate * tail),
        };
        let missed = 1.0 - settings.coverage;
        Self { each: step(0.5 * missed), both: step(missed) }
    }
}

block! {
    /// The interval of one robot.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub(crate) struct ConformalInterval;

    /// The intervals of a block.
    #[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
    #[repr(align(32))]
    pub(crate) struct IntervalLanes {
        /// Distance of each end from the forecast, in sizes, for readings with a new measurement due
        /// (or unknown), and without.
        below_due: f32,
        above_due: f32,
        below_held: f32,
        above_held: f32,
        /// Recent mean size of the residuals, W.
        size_due_w: f32,
        size_held_w: f32,
        recent: f32,
        covered: Count,
        /// Number of residuals so far, saturating at 255.
        seen_due: u8,
        seen_held: u8,
    }
}

impl ConformalInterval {
    /// Starts from the model's residual quantiles (5 % and 95 %) and the lower bound of any scale,
    /// W.
    pub(crate) fn new(q05_w: f32, q95_w: f32, floor_w: f32, coverage: f32) -> Self {
        // Half of the distance between the quantiles is two mean sizes of a normal distribution.
        let size_w = (0.25 * (q95_w - q05_w)).max(floor_w).max(f32::MIN_POSITIVE);
        let factor = |end_w: f32| (end_w / size_w).clamp(FACTOR.0, FACTOR.1);
        let (below, above) = (factor(-q05_w), factor(q95_w));
        Self {
            below_due: below,
            above_due: above,
            below_held: below,
            above_held: above,
            size_due_w: size_w,
            size_held_w: size_w,
            covered: 0,
            recent: coverage,
            seen_due: 0,
            seen_held: 0,
        }
    }

    /// Records a residual (finite), counts whether it was covered, and adapts the ends. `due`:
    /// whether a new measurement was due.
    #[inline(always)]
    pub(crate) fn observe(
        &mut self,
        residual_w: f32,
        due: bool,
        floor_w: f32,
        quantile_step: QuantileStep,
    ) {
        let (below, above, size_w) = self.phase(due);
        let (over, under) = (residual_w > size_w * above, residual_w < -(size_w * below));
        let covered = !(over | under);
        self.covered += u64::from(covered);
        self.recent += COVERAGE_WEIGHT * (if covered { 1.0 } else { 0.0 } - self.recent);
        let moved = |factor: f32, other: f32, missed: bool| {
            let alone = other <= FACTOR.0;
            let (each, both) = (quantile_step.each, quantile_step.both);
            let grow = if alone { both.grow } else { each.grow };
            let shrink = if alone { both.shrink } else { each.shrink };
            (factor * if missed { grow } else { shrink }).clamp(FACTOR.0, FACTOR.1)
        };
        let (moved_above, moved_below) = (moved(above, below, over), moved(below, above, under));
        // The size from the training is soon forgotten.
        let seen = if due { self.seen_due } else { self.seen_held };
        let weight = RECENT_WEIGHT.max(1.0 / (1.0 + TRUST + f32::from(seen)));
        let floor_w = if due { floor_w } else { HELD_FLOOR * floor_w };
        let recent_w = residual_w.abs().min(MAX_RESIDUAL_W);
        let size_w = (size_w + weight * (recent_w - size_w)).max(floor_w);
        let seen = seen.saturating_add(1);
        put(&mut self.above_due, due, moved_above);
        put(&mut self.below_due, due, moved_below);
        put(&mut self.above_held, !due, moved_above);
        put(&mut self.below_held, !due, moved_below);
        put(&mut self.size_due_w, due, size_w);
        put(&mut self.size_held_w, !due, size_w);
        put(&mut self.seen_due, due, seen);
        put(&mut self.seen_held, !due, seen);
    }

    /// Factors of the ends and size of the residuals, W, for readings with or without a new
    /// measurement due.
    #[inline(always)]
    fn phase(&self, due: bool) -> (f32, f32, f32) {
        let of = |if_due: f32, if_held: f32| if due { if_due } else { if_held };
        (
            of(self.below_due, self.below_held),
            of(self.above_due, self.above_held),
            of(self.size_due_w, self.size_held_w),
        )
    }

    /// Sizes and factors, for readings with and without a new measurement due.
    #[inline(always)]
    pub(crate) fn scale(&self) -> IntervalScale {
        let of = |due| {
            let (below, above, size_w) = self.phase(due);
            EndScale { below, above, size_w }
        };
        IntervalScale { due: of(true), held: of(false) }
    }

    /// Share of the readings inside, over all and recently. NaN before the first. `share` weighs
    /// one reading, infinite before the first.
    #[inline(always)]
    pub(crate) fn coverage(&self, share: f64) -> (f32, f32) {
        let over_all = (self.covered as f64 * share) as f32;
        let observed = share <= 1.0;
        let recent = if observed { self.recent } else { f32::NAN };
        (if observed { over_all } else { f32::NAN }, recent)
    }

    /// The interval around `forecast_w`, `open_steps` sample periods after the last reading: it
    /// widens with the square root of the steps, like a random walk. `due`: whether a new
    /// measurement is due.
    #[inline(always)]
    pub(crate) fn around(&self, forecast_w: f32, open_steps: u16, due: bool) -> (f32, f32) {
        let (below, above, size_w) = self.phase(due);
        let size_w = size_w * (1.0 + f32::from(open_steps)).sqrt();
        (forecast_w - size_w * below, forecast_w + size_w * above)
    }
}

/// Inputs of an interval, for readings with and without a new measurement due.
#[derive(Debug, Clone, Copy)]
pub(crate) struct IntervalScale {
    pub due: EndScale,
    pub held: EndScale,
}

/// Size of the residuals, W, and distance of the ends from the forecast, in sizes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct EndScale {
    pub size_w: f32,
    pub below: f32,
    pub above: f32,
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const SETTINGS: IntervalSettings = IntervalSettings { coverage: 0.9, rate: 0.2 };

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
            let (all, recent) = interval.coverage(1.0 / 4_000.0);
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
            let (mut missed, mut observed, mut moved) = (0.0f32, 0.0f32, 0.0f32);
            for (value, exponent, due) in residuals {
                let before = interval;
                let residual_w = value * 10f32.powi(exponent);
                interval.observe(residual_w, due, 1e-9, quantile_step);
                let inside = |factor: f32| FACTOR.0 < factor && factor < FACTOR.1;
                if !(inside(interval.above_due) && inside(interval.below_due)) {
                    break;
                }
                if due {
                    let (_, hi_w) = before.around(0.0, 0, due);
                    missed += if residual_w > hi_w { 1.0 } else { 0.0 };
                    observed += 1.0;
                }
                moved = (interval.above_due / 2.0).ln() / SETTINGS.rate;
            }
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
    fn under_a_bias_the_forecast_stays_inside_and_coverage_is_held() {
        let mut interval = ConformalInterval::new(-0.2, 0.2, 0.001, 0.9);
        let quantile_step = QuantileStep::new(&SETTINGS);
        let mut covered = 0;
        for step in 0..6_000u32 {
            let (lo_w, hi_w) = interval.around(5.0, 0, true);
            assert!(lo_w <= 5.0 && 5.0 <= hi_w, "{interval:?}");
            let residual_w = 3.0 + 0.2 * (step as f32 * 1.7).sin();
            let inside = lo_w <= 5.0 + residual_w && 5.0 + residual_w <= hi_w;
            covered += u32::from(step >= 2_000 && inside);
            interval.observe(residual_w, true, 0.001, quantile_step);
        }
        let share = f64::from(covered) / 4_000.0;
        assert!((0.89..=0.91).contains(&share), "{share}");
    }

    #[test]
    fn held_readings_have_an_interval_of_their_own() {
        let mut interval = ConformalInterval::new(-0.2, 0.2, 0.001, 0.9);
        let quantile_step = QuantileStep::new(&SETTINGS);
        for step in 0..3_000u32 {
            let due = step % 3 == 0;
            let size_w = if due { 0.2 } else { 0.002 };
            interval.observe(size_w * (step as f32 * 1.7).sin(), due, 0.001, quantile_step);
        }
        let width_w = |due| {
            let (lo_w, hi_w) = interval.around(0.0, 0, due);
            hi_w - lo_w
        };
        assert!(width_w(true) > 30.0 * width_w(false), "{interval:?}");
        let (all, _) = interval.coverage(1.0 / 3_000.0);
        assert!((0.89..=0.92).contains(&all), "{all}");
    }
}
