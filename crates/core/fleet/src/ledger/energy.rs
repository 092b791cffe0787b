//! Exact integer energy account of one robot.

use serde::{Deserialize, Serialize};

use crate::layout::lanes::{DurationNs, InstantNs, block, put};
use crate::layout::shift::Shift;

/// µW·ns in one µJ, times 2: the trapezoid is summed without halving.
const UNITS_PER_UJ: i64 = 2_000_000_000;

block! {
    /// Energy drawn, metered and unmetered time of one robot.
    ///
    /// Exact: `metered_ns + unmetered_ns` is always the time between the first stamp and the last,
    /// and the integral loses nothing to rounding (remainders below one µJ are carried). A total in
    /// `f32` would have an error of 3.6 % after 30 days.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
    pub struct Ledger: NONE;

    /// The ledgers of a block.
    #[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
    #[repr(align(16))]
    pub(crate) struct LedgerLanes {
        /// Energy drawn over the metered time, µJ.
        pub drawn_uj: i64 = 0,
        /// Forecast energy over the same time, µJ.
        pub forecast_uj: i64 = 0,
        /// Time between consecutive readings without a gap, ns.
        pub metered_ns: DurationNs = 0,
        /// All other time, ns.
        pub unmetered_ns: DurationNs = 0,
        stamp_ns: InstantNs = 0,
        /// Remainder of the integral below one µJ, in µW·ns · 2, from 0 to 1,999,999,999.
        pub drawn_remainder: u32 = 0,
        /// Same as `drawn_remainder`.
        forecast_remainder: u32 = 0,
        /// Bits of the last reading in W, NaN's if there is none.
        last_power: u32 = f32::NAN.to_bits(),
        /// True if `stamp_ns` belongs to a sample.
        begun: bool = false,
    }
}

impl Default for Ledger {
    fn default() -> Self {
        Self::NONE
    }
}

impl Ledger {
    /// A saved ledger: the time until the next sample will be unmetered.
    pub fn restored(
        drawn: (i64, i64),
        forecast_uj: i64,
        metered_ns: u64,
        unmetered_ns: u64,
        stamp_ns: u64,
    ) -> Self {
        Self {
            drawn_uj: drawn.0,
            // Below 2,000,000,000: it fits.
            drawn_remainder: drawn.1.clamp(0, UNITS_PER_UJ - 1) as u32,
            forecast_uj,
            metered_ns,
            unmetered_ns,
            stamp_ns,
            begun: true,
            ..Self::default()
        }
    }

    /// Stamp of the newest sample, ns. `None` before the first.
    pub fn stamp_ns(&self) -> Option<u64> {
        self.begun.then_some(self.stamp_ns)
    }

    /// Moves the newest stamp to another clock. Time before that clock began is unmetered at once,
    /// so that none is lost.
    pub(crate) fn shift(&mut self, shift: Shift) {
        let before_ns = self.shift_instants(shift);
        self.unmetered_ns = self.unmetered_ns.saturating_add(before_ns);
    }

    /// Records a sample: its stamp, the reading in W if there is one, and its forecast. Time counts
    /// as metered between two readings at most `longest_ns` apart.
    ///
    /// A stamp before the last one (after a reboot, or of another source) adds no time, and later
    /// ones add none up to the last one: each moment is counted once.
    pub fn meter(
        &mut self,
        stamp_ns: u64,
        power_w: Option<f32>,
        forecast_w: Option<f32>,
        longest_ns: u64,
    ) {
        let before_w = Some(f32::from_bits(self.last_power)).filter(|watts| !watts.is_nan());
        let elapsed_ns = self.stamp_ns().map_or(0, |last| stamp_ns.saturating_sub(last));
        match (before_w, power_w) {
            (Some(before), Some(now)) if elapsed_ns <= longest_ns => {
                self.metered_ns = self.metered_ns.saturating_add(elapsed_ns);
                let drawn = (microwatts(before), microwatts(now));
                let expected = forecast_w.map_or(drawn, |watts| {
                    let expected = microwatts(watts);
                    (expected, expected)
                });
                let (uj, rest) = integral(self.drawn_remainder, drawn, elapsed_ns);
                self.drawn_uj = self.drawn_uj.saturating_add(uj);
                self.drawn_remainder = rest;
                let (uj, rest) = integral(self.forecast_remainder, expected, elapsed_ns);
                self.forecast_uj = self.forecast_uj.saturating_add(uj);
                self.forecast_remainder = rest;
            }
            _ => self.unmetered_ns = self.unmetered_ns.saturating_add(elapsed_ns),
        }
        (self.stamp_ns, self.begun) = (self.stamp_ns.max(stamp_ns), true);
        self.last_power = power_w.unwrap_or(f32::NAN).to_bits();
    }
}

/// Twice a power below this, in µW, and a time below [`LONG_NS`] are multiplied exactly in two
/// parts: four megawatts, and two seconds.
const STRONG_UW: f64 = (1u64 << 42) as f64;
const LONG_NS: u64 = 1 << 31;
/// Divisor that splits a power into two parts.
const SPLIT: f64 = (1u64 << 20) as f64;
/// Adding it to a number below 2⁵¹ leaves the nearest integer in the lowest bits.
const ROUND: f64 = 1.5 * (1u64 << 52) as f64;

impl Ledger {
    /// Same as [`Ledger::meter`], with NaN for a missing reading or forecast, and without branches.
    /// It uses double precision, which is exact for everything that a robot can draw in a sample
    /// period. Returns whether it was exact. Otherwise the ledger is invalid.
    #[inline(always)]
    pub(crate) fn meter_narrow(
        &mut self,
        stamp_ns: u64,
        power_w: f32,
        forecast_w: f32,
        longest_ns: u64,
    ) -> bool {
        let before_w = f32::from_bits(self.last_power);
        let later = self.begun & (stamp_ns > self.stamp_ns);
        let elapsed_ns = if later { stamp_ns - self.stamp_ns } else { 0 };
        let metered = !before_w.is_nan() & !power_w.is_nan() & (elapsed_ns <= longest_ns);
        let (before_uw, now_uw) = (whole_microwatts(before_w), whole_microwatts(power_w));
        let expected_uw = 2.0 * whole_microwatts(forecast_w);
        let drawn_uw = before_uw + now_uw;
        let expected_uw = if forecast_w.is_nan() { drawn_uw } else { expected_uw };
        let narrow = (elapsed_ns < LONG_NS)
            & (before_uw.abs() < 0.5 * STRONG_UW)
            & (now_uw.abs() < 0.5 * STRONG_UW)
            & (expected_uw.abs() < STRONG_UW);
        let elapsed = f64::from(elapsed_ns as u32);
        let drawn = integral_narrow(self.drawn_remainder, drawn_uw, elapsed);
        let expected = integral_narrow(self.forecast_remainder, expected_uw, elapsed);
        self.drawn_uj = self.drawn_uj.saturating_add(if metered { drawn.0 } else { 0 });
        self.forecast_uj = self.forecast_uj.saturating_add(if metered { expected.0 } else { 0 });
        put(&mut self.drawn_remainder, metered, drawn.1);
        put(&mut self.forecast_remainder, metered, expected.1);
        let metered_ns = self.metered_ns.saturating_add(elapsed_ns);
        let unmetered_ns = self.unmetered_ns.saturating_add(elapsed_ns);
        put(&mut self.metered_ns, metered, metered_ns);
        put(&mut self.unmetered_ns, !metered, unmetered_ns);
        (self.stamp_ns, self.begun) = (self.stamp_ns.max(stamp_ns), true);
        self.last_power = power_w.to_bits();
        narrow | !metered
    }
}

/// Same as [`microwatts`], as an integer.
#[inline(always)]
fn whole_microwatts(power_w: f32) -> f64 {
    let exact_uw = f64::from(power_w) * 1e6;
    (exact_uw + 0.5f64.copysign(exact_uw)).trunc()
}

/// Same as [`integral`], for twice a power in µW and a time in ns, both integers within bounds.
#[inline(always)]
fn integral_narrow(remainder: u32, twice_uw: f64, elapsed_ns: f64) -> (i64, u32) {
    let high = (twice_uw * (1.0 / SPLIT) + ROUND) - ROUND;
    let low = twice_uw - high * SPLIT;
    let (whole_high, rest) = divided(high * elapsed_ns);
    let (whole, rest) = divided(rest * SPLIT + low * elapsed_ns + f64::from(remainder));
    let bits = |number: f64| (number + ROUND).to_bits().wrapping_sub(ROUND.to_bits());
    (bits(whole_high * SPLIT + whole) as i64, bits(rest) as u32)
}

/// Whole µJ in an integer below 2⁵³, and the remainder, from 0 to 1,999,999,999.
#[inline(always)]
fn divided(sum: f64) -> (f64, f64) {
    let units = UNITS_PER_UJ as f64;
    // The quotient is off by at most one, and the remainder is exact.
    let nearest = (sum * (1.0 / units) + ROUND) - ROUND;
    let rest = sum - nearest * units;
    let below = rest < 0.0;
    (if below { nearest - 1.0 } else { nearest }, if below { rest + units } else { rest })
}

/// Whole µJ of a trapezoid between two powers in µW plus the remainder before it, and the remainder
/// after it. The energy of a robot in a sample period fits into 64 bits by a factor of ten
/// thousand.
fn integral(remainder: u32, ends_uw: (i64, i64), elapsed_ns: u64) -> (i64, u32) {
    let narrow = || {
        let twice = ends_uw.0.checked_add(ends_uw.1)?;
        let area = twice.checked_mul(i64::try_from(elapsed_ns).ok()?)?;
        area.checked_add(remainder.into())
    };
    match narrow() {
        // Below 2,000,000,000: it fits.
        Some(sum) => (sum.div_euclid(UNITS_PER_UJ), sum.rem_euclid(UNITS_PER_UJ) as u32),
        None => wide_integral(remainder, ends_uw, elapsed_ns),
    }
}

/// The same for absurd powers and times.
#[cold]
fn wide_integral(remainder: u32, ends_uw: (i64, i64), elapsed_ns: u64) -> (i64, u32) {
    let twice = i128::from(ends_uw.0) + i128::from(ends_uw.1);
    // Saturates only if power and time are both absurd.
    let sum = twice.saturating_mul(elapsed_ns.into());
    let sum = sum.saturating_add(remainder.into());
    let units = i128::from(UNITS_PER_UJ);
    let whole = sum.div_euclid(units);
    (whole.clamp(i64::MIN.into(), i64::MAX.into()) as i64, sum.rem_euclid(units) as u32)
}

/// Rounded to the nearest µW, halves away from zero. An absurd forecast saturates.
fn microwatts(power_w: f32) -> i64 {
    // Exact: 24 bits times 14. So is adding the half wherever it matters, and `as` saturates.
    let exact_uw = f64::from(power_w) * 1e6;
    (exact_uw + 0.5f64.copysign(exact_uw)) as i64
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const MAX_NS: u64 = 50_000_000;

    #[test]
    fn time_between_an_earlier_stamp_and_the_last_one_is_not_counted_again() {
        let (mut wide, mut narrow) = (Ledger::default(), Ledger::default());
        let stamps_ms = [1_000, 1_020, 1_005, 1_015, 1_040, 1_040, 1_060];
        for stamp_ns in stamps_ms.map(|ms: u64| 1_000_000 * ms) {
            wide.meter(stamp_ns, Some(3.0), None, MAX_NS);
            assert!(narrow.meter_narrow(stamp_ns, 3.0, f32::NAN, MAX_NS));
        }
        for ledger in [wide, narrow] {
            assert_eq!(ledger.stamp_ns(), Some(1_060_000_000));
            assert_eq!((ledger.metered_ns, ledger.unmetered_ns), (60_000_000, 0));
            assert_eq!(ledger.drawn_uj, 180_000);
        }
    }

    proptest! {
        /// Against one exact rational sum over all samples.
        #[test]
        fn the_ledger_equals_an_exact_sum_and_time_adds_up(
            samples in prop::collection::vec(
                (0u64..120_000_000, prop::option::weighted(0.9, -50.0f32..500.0)), 1..200)
        ) {
            let mut ledger = Ledger::default();
            let (mut stamp_ns, mut exact, mut metered_ns) = (1_000u64, 0i128, 0u64);
            let (start_ns, mut before) = (stamp_ns + samples[0].0, None);
            for (index, (step_ns, power_w)) in samples.iter().enumerate() {
                stamp_ns += step_ns;
                ledger.meter(stamp_ns, *power_w, None, MAX_NS);
                let now = power_w.map(|watts| (f64::from(watts) * 1e6).round() as i128);
                if let (Some(a), Some(b)) = (before, now)
                    && index > 0 && *step_ns <= MAX_NS
                {
                    exact += (a + b) * i128::from(*step_ns);
                    metered_ns += step_ns;
                }
                before = now;
            }
            let kept = i128::from(ledger.drawn_uj) * i128::from(UNITS_PER_UJ)
                + i128::from(ledger.drawn_remainder);
            prop_assert_eq!(kept, exact);
            prop_assert_eq!(ledger.forecast_uj, ledger.drawn_uj);
            prop_assert_eq!(ledger.metered_ns, metered_ns);
            prop_assert_eq!(ledger.metered_ns + ledger.unmetered_ns, stamp_ns - start_ns);
        }

        #[test]
        fn a_restored_ledger_continues_exactly_and_the_gap_is_unmetered(
            powers in prop::collection::vec(0.0f32..100.0, 4..60), cut in 1usize..3, gap_ns in 1u64..10_000_000_000
        ) {
            let cut = cut.min(powers.len() - 1);
            let mut ledger = Ledger::default();
            let mut stamp_ns = 7;
            for power_w in &powers[..cut] {
                stamp_ns += 33_000_000;
                ledger.meter(stamp_ns, Some(*power_w), None, MAX_NS);
            }
            let mut again = Ledger::restored(
                (ledger.drawn_uj, ledger.drawn_remainder.into()), ledger.forecast_uj,
                ledger.metered_ns, ledger.unmetered_ns, stamp_ns);
            stamp_ns += gap_ns;
            again.meter(stamp_ns, Some(powers[cut]), None, MAX_NS);
            prop_assert_eq!(again.drawn_uj, ledger.drawn_uj);
            prop_assert_eq!(again.unmetered_ns, ledger.unmetered_ns + gap_ns);
            prop_assert_eq!(again.metered_ns, ledger.metered_ns);
        }
    }

    proptest! {
        #[test]
        fn the_fast_integral_and_microwatts_equal_the_exact_ones(
            remainder in 0u32..2_000_000_000, bits in any::<(u32, u32)>(), elapsed_ns in any::<u64>(),
            shift in 0u32..64,
        ) {
            let (before, now) = (f32::from_bits(bits.0), f32::from_bits(bits.1));
            let rounded = |watts: f32| (f64::from(watts) * 1e6).round() as i64;
            prop_assert_eq!(microwatts(before), rounded(before));
            let near = (before % 8.0, now % 8.0);
            prop_assert_eq!(microwatts(near.0), rounded(near.0));
            for (before, now) in [(before, now), near] {
                let ends_uw = (microwatts(before), microwatts(now));
                let elapsed_ns = elapsed_ns >> shift;
                prop_assert_eq!(
                    integral(remainder, ends_uw, elapsed_ns),
                    wide_integral(remainder, ends_uw, elapsed_ns)
                );
            }
        }
    }

    /// Mostly realistic powers, sometimes arbitrary ones.
    fn watts() -> impl Strategy<Value = f32> {
        prop_oneof![
            6 => -50.0f32..500.0,
            2 => -1e6f32..1e6,
            1 => Just(f32::NAN),
            1 => any::<u32>().prop_map(f32::from_bits),
        ]
    }

    proptest! {
        #[test]
        fn the_branchless_ledger_is_the_same_or_reports_that_it_is_not(
            samples in prop::collection::vec((watts(), watts(), 0u32..64, any::<u64>()), 1..60),
            longest_ns in prop_oneof![4 => Just(MAX_NS), 1 => any::<u64>()],
        ) {
            let (mut ledger, mut stamp_ns) = (Ledger::default(), 5u64);
            for (power_w, forecast_w, shift, step_ns) in samples {
                let step_ns = if shift < 56 { step_ns % 60_000_000 } else { step_ns >> (shift % 40) };
                stamp_ns = stamp_ns.wrapping_add(step_ns);
                let known = |watts: f32| (!watts.is_nan()).then_some(watts);
                let mut expected = ledger;
                expected.meter(stamp_ns, known(power_w), known(forecast_w), longest_ns);
                // Callers pass the canonical NaN only.
                let power_w = known(power_w).unwrap_or(f32::NAN);
                if ledger.meter_narrow(stamp_ns, power_w, forecast_w, longest_ns) {
                    prop_assert_eq!(ledger, expected);
                }
                ledger = expected;
            }
        }

        #[test]
        fn all_allowed_powers_are_metered_without_a_branch(
            samples in prop::collection::vec((-1e6f32..1e6, -1e6f32..1e6), 2..60),
            period_ns in 1u64..2_000_000_000,
        ) {
            let mut ledger = Ledger::default();
            for (step, (power_w, forecast_w)) in samples.into_iter().enumerate() {
                let stamp_ns = 5 + step as u64 * period_ns;
                prop_assert!(ledger.meter_narrow(stamp_ns, power_w, forecast_w, 2 * period_ns));
            }
            prop_assert!(ledger.metered_ns > 0);
        }
    }

    #[test]
    fn half_a_microwatt_is_rounded_away_from_zero() {
        // Odd multiples of 2^-7 W times 10^6 end in one half.
        for (power_w, expected_uw) in [
            (0.007_812_5, 7_813),
            (-0.007_812_5, -7_813),
            (0.023_437_5, 23_438),
            (4.999_999e-7, 0),
            (f32::INFINITY, i64::MAX),
            (-f32::MAX, i64::MIN),
        ] {
            assert_eq!(microwatts(power_w), expected_uw, "{power_w}");
        }
    }

    #[test]
    fn thirty_days_at_100_w_drift_by_less_than_a_microjoule() {
        let mut ledger = Ledger::default();
        let steps = 30 * 24 * 3600 * 10u64;
        for step in 0..=steps {
            ledger.meter(step * 100_000_000, Some(100.0), None, 150_000_000);
        }
        assert_eq!(ledger.drawn_uj, 30 * 24 * 3600 * 100 * 1_000_000);
    }
}
