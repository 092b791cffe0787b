//! Intervals that hold their coverage: adaptive conformal inference by tracking quantiles.
//!
//! Each end moves by a small step whenever a reading falls outside it, and back by a much smaller
//! one when it does not, so that in the long run the wanted share of readings lies inside, whatever
//! the residuals do (Angelopoulos, Candès, Tibshirani, "Conformal PID control", 2023, section 2).

use serde::{Deserialize, Serialize};

use crate::IntervalSettings;

/// Weight of the newest residual in the scale of the steps and in the recent coverage.
const RECENT_WEIGHT: f32 = 0.005;

/// The interval of one robot, as distances from its forecast.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Interval {
    /// Distance of the lower end below the forecast, W.
    pub below_w: f32,
    /// Distance of the upper end above the forecast, W.
    pub above_w: f32,
    scale_w: f32,
    covered: u64,
    recent: f32,
}

impl Interval {
    /// From the model's residual quantiles (5 % and 95 %) and the floor of any scale, W.
    pub(crate) fn new(q05_w: f32, q95_w: f32, std_w: f32, floor_w: f32, coverage: f32) -> Self {
        Self {
            below_w: (-q05_w).max(floor_w),
            above_w: q95_w.max(floor_w),
            scale_w: std_w.max(floor_w),
            covered: 0,
            recent: coverage,
        }
    }

    /// Takes a residual (finite), counts whether it was covered, and moves the ends.
    pub(crate) fn observe(&mut self, residual_w: f32, floor_w: f32, settings: &IntervalSettings) {
        let (over, under) = (residual_w > self.above_w, residual_w < -self.below_w);
        let covered = !over && !under;
        self.covered += u64::from(covered);
        self.recent += RECENT_WEIGHT * (f32::from(u8::from(covered)) - self.recent);
        let tail = 0.5 * (1.0 - settings.coverage);
        let moved = |end_w: f32, missed: bool| {
            // In proportion to the end where it lies far out: an interval that starts a hundred
            // times too wide is then right within minutes, not days.
            let step_w = settings.rate * self.scale_w.max(end_w.abs());
            end_w + step_w * (f32::from(u8::from(missed)) - tail)
        };
        (self.above_w, self.below_w) = (moved(self.above_w, over), moved(self.below_w, under));
        // Under a lasting bias both ends may lie on one side of the forecast, but never cross.
        self.below_w = self.below_w.max(-self.above_w);
        self.scale_w += RECENT_WEIGHT * (residual_w.abs().max(floor_w) - self.scale_w);
    }

    /// Share inside of the `observed` readings, over all and of late; NaN before the first.
    pub(crate) fn coverage(&self, observed: u64) -> (f32, f32) {
        if observed == 0 {
            return (f32::NAN, f32::NAN);
        }
        ((self.covered as f64 / observed as f64) as f32, self.recent)
    }

    /// The interval around `forecast_w`, `open_steps` sample periods after the last reading: it
    /// widens with the square root of the steps, as a random walk would.
    pub(crate) fn around(&self, forecast_w: f32, open_steps: u16) -> (f32, f32) {
        let wider = (1.0 + f32::from(open_steps)).sqrt();
        (
            forecast_w - self.below_w * wider,
            forecast_w + self.above_w * wider,
        )
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const SETTINGS: IntervalSettings = IntervalSettings {
        coverage: 0.9,
        rate: 0.05,
    };

    proptest! {
        #[test]
        fn coverage_is_held_whatever_the_scale_and_the_shift(
            scale in 0.01f32..100.0, shift in -2.0f32..2.0, seed in any::<u32>()
        ) {
            let mut interval = Interval::new(-1.0, 1.0, 1.0, 0.01, 0.9);
            let mut state = u64::from(seed) | 1;
            for step in 0..40_000 {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                let uniform = (state >> 40) as f32 / (1 << 24) as f32 - 0.5;
                let drift = if step > 20_000 { shift } else { 0.0 };
                interval.observe(scale * (uniform + drift), 0.0, &SETTINGS);
            }
            let (all, recent) = interval.coverage(40_000);
            prop_assert!((0.88..=0.92).contains(&all), "{all}");
            prop_assert!((0.8..=0.98).contains(&recent), "{recent}");
        }
    }

    #[test]
    fn the_interval_contains_its_forecast_and_widens_open_loop() {
        let interval = Interval::new(-0.05, 0.05, 0.03, 0.01, 0.9);
        let (mut lo, mut hi) = interval.around(3.6, 0);
        assert!(lo < 3.6 && 3.6 < hi);
        for steps in 1..30 {
            let wider = interval.around(3.6, steps);
            assert!(wider.0 < lo && wider.1 > hi);
            (lo, hi) = wider;
        }
    }
}
