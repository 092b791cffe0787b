//! Age of the newest reading.
//!
//! A power monitor that measures less often than the robot is sampled repeats its readings: two of
//! three GTernal readings, polled at 10 Hz and returned at 30 Hz, are held. Such a reading is known
//! in advance, and a network that knows its age can forecast it exactly.

use serde::{Deserialize, Serialize};

use crate::features::{FEATURES, Features};

/// Age of a robot's last measurement, and the interval between measurements, both counted in its
/// own samples: no clock is used, so the same samples give the same bits whenever they are
/// replayed.
///
/// Every sample with a reading is [`ReadingAge::read`]. Every sample period without one is
/// [`ReadingAge::pass`]ed, by the schedule that the robot has kept so far. The *interval* between
/// two measurements is estimated: a shorter one is adopted at once, a longer one by one sample at a
/// time, because a new measurement equal to the previous one is mistaken for a held reading.
///
/// ```
/// use joulebus_predictor::ReadingAge;
///
/// let mut age = ReadingAge::UNKNOWN;
/// for is_new in [true, false, true, false] {
///     age.read(is_new);
/// }
/// assert_eq!((age.age_steps(), age.interval_steps()), (Some(1), Some(2)));
/// assert_eq!(age.is_due(), Some(true));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReadingAge {
    /// Samples since the last measurement, or [`NEVER`].
    age_steps: u8,
    /// Samples from one measurement to the next, 0 until two have been seen.
    interval_steps: u8,
}

/// Value of the age before the first measurement: one more than the maximum age.
const NEVER: u8 = u8::MAX;

impl ReadingAge {
    /// Maximum of the age feature: a second at 30 Hz, the slowest default poll period, so that a
    /// robot at rest for an hour is no outlier.
    pub const MAX_STEPS: u8 = 30;

    /// Before the first measurement.
    pub const UNKNOWN: ReadingAge = ReadingAge { age_steps: NEVER, interval_steps: 0 };

    /// Converts it to bytes, for storage in columns.
    #[inline(always)]
    pub const fn to_bytes(self) -> [u8; 2] {
        [self.age_steps, self.interval_steps]
    }

    /// Creates it from [`ReadingAge::to_bytes`]. Any two bytes are valid.
    #[inline(always)]
    pub const fn from_bytes([age_steps, interval_steps]: [u8; 2]) -> ReadingAge {
        ReadingAge { age_steps, interval_steps }
    }

    /// Takes the next sample, with a new measurement or a held reading.
    #[inline(always)]
    pub fn read(&mut self, new: bool) {
        // A held reading without a known measurement has no age.
        let older = self.older_by(1);
        let interval_steps = self.age_steps.wrapping_add(1);
        let learned = if self.interval_steps == 0 {
            interval_steps
        } else {
            interval_steps.min(self.interval_steps.saturating_add(1))
        };
        let learns = new & (self.age_steps != NEVER);
        self.interval_steps = if learns { learned } else { self.interval_steps };
        self.age_steps = if new { 0 } else { older };
    }

    /// Advances by sample periods without a reading. A measurement that was due is assumed to have
    /// been made, as in open loop.
    pub fn pass(&mut self, steps: u64) {
        let (age, interval) = (u64::from(self.age_steps), u64::from(self.interval_steps));
        if interval == 0 {
            self.age_steps = self.older_by(steps);
            return;
        }
        // An overdue measurement is assumed at the next step.
        let to_next = interval.saturating_sub(age).max(1);
        self.age_steps = match steps.checked_sub(to_next) {
            // Less than an interval, which is a `u8`.
            Some(since) => (since % interval) as u8,
            None => self.older_by(steps),
        };
    }

    /// The state after [`ReadingAge::pass`].
    #[must_use]
    pub fn after(mut self, steps: u64) -> ReadingAge {
        self.pass(steps);
        self
    }

    /// True if two measurements have been seen. The features are NaN before.
    #[inline(always)]
    pub fn is_known(&self) -> bool {
        self.age_steps != NEVER && self.interval_steps > 0
    }

    /// Samples since the last measurement, at most 254. `None` before the first.
    pub fn age_steps(&self) -> Option<u8> {
        (self.age_steps != NEVER).then_some(self.age_steps)
    }

    /// Samples from one measurement to the next, at least 1. `None` until two have been seen.
    pub fn interval_steps(&self) -> Option<u8> {
        self.is_known().then_some(self.interval_steps)
    }

    /// True if a new measurement is due with the next sample, or overdue. `None` if unknown.
    #[inline(always)]
    pub fn is_due(&self) -> Option<bool> {
        // A known age is below 255.
        let due = self.age_steps.saturating_add(1) >= self.interval_steps;
        self.is_known().then_some(due)
    }

    /// Sets its two features: the age in samples, up to [`ReadingAge::MAX_STEPS`], and whether
    /// a new measurement is due, 1 or 0. Both are NaN if unknown.
    #[inline(always)]
    pub fn fill(&self, row: &mut Features) {
        let (known, due) = (self.is_known(), self.is_due() == Some(true));
        let age_steps = f32::from(self.age_steps.min(Self::MAX_STEPS));
        let due = if due { 1.0 } else { 0.0 };
        row[FEATURES] = if known { age_steps } else { f32::NAN };
        row[FEATURES + 1] = if known { due } else { f32::NAN };
    }

    /// The age after more samples. Unknown stays unknown.
    #[inline(always)]
    fn older_by(&self, steps: u64) -> u8 {
        let steps = steps.min(NEVER.into()) as u8;
        let older = self.age_steps.saturating_add(steps).min(NEVER - 1);
        if self.age_steps == NEVER { NEVER } else { older }
    }

    /// Sample periods missing in `elapsed_ns` between two samples: none until the next one is
    /// overdue by more than half a period, of `period_ns`, which is not 0.
    #[must_use]
    #[inline]
    pub fn missing_steps(elapsed_ns: u64, period_ns: u64) -> u64 {
        if elapsed_ns <= period_ns + period_ns / 2 {
            return 0;
        }
        ((elapsed_ns - period_ns) + period_ns / 2) / period_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_is_declared_past_half_a_period_and_counted_by_rounding() {
        let cases =
            [(0, 0), (10, 0), (15, 0), (16, 1), (20, 1), (24, 1), (25, 2), (34, 2), (35, 3)];
        for (elapsed, missing) in cases {
            assert_eq!(
                ReadingAge::missing_steps(elapsed, 10),
                missing,
                "after {elapsed} of period 10"
            );
        }
        assert_eq!(ReadingAge::missing_steps(u64::MAX, 1), u64::MAX - 1);
    }

    fn features(reading_age: ReadingAge) -> [f32; 2] {
        let mut row = [f32::NAN; FEATURES + 2];
        reading_age.fill(&mut row);
        [row[FEATURES], row[FEATURES + 1]]
    }

    fn of(pattern: &str) -> ReadingAge {
        let mut reading_age = ReadingAge::UNKNOWN;
        for sample in pattern.bytes() {
            reading_age.read(sample == b'n');
        }
        reading_age
    }

    #[test]
    fn the_interval_is_estimated_and_robust_to_one_equal_reading() {
        // n: a new measurement, h: a held reading.
        for (pattern, age, interval, due) in [
            ("", None, None, None),
            ("hhh", None, None, None),
            ("hn", Some(0), None, None),
            ("hnhh", Some(2), None, None),
            ("nhhn", Some(0), Some(3), Some(false)),
            ("nhhnh", Some(1), Some(3), Some(false)),
            ("nhhnhh", Some(2), Some(3), Some(true)),
            ("nhhnhhh", Some(3), Some(3), Some(true)),
            ("nn", Some(0), Some(1), Some(true)),
            // The measurement in the middle was equal to its predecessor: six samples, adopted as
            // four.
            ("nhhnhhhhhn", Some(0), Some(4), Some(false)),
            ("nhhnhhhhhnhhn", Some(0), Some(3), Some(false)),
            ("nhhhnhn", Some(0), Some(2), Some(false)),
        ] {
            let found = of(pattern);
            let known = (found.age_steps(), found.interval_steps(), found.is_due());
            assert_eq!(known, (age, interval, due), "{pattern}");
            let [age_feature, due_feature] = features(found);
            match due {
                Some(due) => {
                    assert_eq!(age_feature, f32::from(age.expect("known")), "{pattern}");
                    assert_eq!(due_feature, f32::from(u8::from(due)), "{pattern}");
                }
                None => assert!(age_feature.is_nan() && due_feature.is_nan(), "{pattern}"),
            }
        }
    }

    #[test]
    fn passing_many_periods_at_once_is_passing_them_one_by_one() {
        for pattern in ["", "hh", "nh", "nn", "nhhn", "nhhnh", "nhhnhhhhhh", "nhnhhhhnhhhh"] {
            let mut slow = of(pattern);
            for steps in 0..40 {
                assert_eq!(of(pattern).after(steps), slow, "{pattern} {steps}");
                slow.pass(1);
            }
        }
    }

    #[test]
    fn a_period_without_reading_keeps_the_schedule() {
        let ages = (0..8).map(|steps| of("nhhn").after(steps).age_steps());
        let expected = [0, 1, 2, 0, 1, 2, 0, 1].map(Some);
        assert!(ages.eq(expected));
        let due = (0..4).map(|steps| of("nhhn").after(steps).is_due());
        assert!(due.eq([false, false, true, false].map(Some)));
    }

    #[test]
    fn nothing_overflows_in_a_robot_at_rest() {
        let mut reading_age = of("nhhn");
        for _ in 0..10_000 {
            reading_age.read(false);
        }
        assert_eq!(reading_age.age_steps(), Some(254));
        assert_eq!(features(reading_age), [30.0, 1.0]);
        reading_age.read(true);
        assert_eq!(reading_age.interval_steps(), Some(4));
        let mut first = of("n");
        first.pass(u64::MAX);
        first.read(true);
        assert_eq!((first.age_steps(), first.interval_steps()), (Some(0), Some(255)));
        first.pass(u64::MAX);
        assert_eq!(first.age_steps(), Some((u64::MAX % 255) as u8));
        for _ in 0..300 {
            first.read(false);
        }
        assert_eq!(first.is_due(), Some(true));
        first.read(true);
        assert_eq!(first.interval_steps(), Some(255));
    }
}
