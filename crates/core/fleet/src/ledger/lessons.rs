//! What the charges of a battery teach: pairs of known charges, and the rates at which it charges.

use joulebus_wire::CHARGE_TENTHS;
use serde::{Deserialize, Serialize};

use crate::layout::lanes::block;

/// Part of a tenth that must be charged in one go to tell the rate of the tenth.
const MIN_PART: f64 = 0.5;

block! {
    /// The capacity's part that the tick does not need, the pair that has begun, and charging rates.
    #[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
    pub(crate) struct Lessons: NONE {
        /// Weight of the pairs.
        pub weight: f32 = 0.0,
        /// The charge that began a pair, and what was counted then. 0: none has begun.
        start: f32 = 0.0,
        start_counted: f32 = 0.0,
        /// Standard deviation of that charge. 0 if it was measured.
        start_sd: f32 = 0.0,
        /// In thousandths of the capacity an hour, by tenth of the charge. 0 if unknown.
        pub charge_rate: [u16; CHARGE_TENTHS] = [0; CHARGE_TENTHS],
        /// The charge from which the present tenth is charged, and for how long, s. 0: it is not.
        tenth_from: f32 = 0.0,
        tenth_s: f32 = 0.0,
    }
}

/// A pair of known charges.
pub(crate) struct Pair {
    pub depth: f32,
    pub depth_sd: f32,
    /// The counted share between the two.
    pub counted: f32,
}

impl Lessons {
    /// Those of an earlier run.
    pub(crate) fn continued(charge_rate: [u16; CHARGE_TENTHS]) -> Self {
        Self { charge_rate, ..Self::NONE }
    }

    /// A pair begins with a charge, what was counted until it, and its standard deviation.
    pub(crate) fn begin(&mut self, (soc, counted, sd): (f64, f64, f64)) {
        (self.start, self.start_counted) = (soc as f32, counted as f32);
        self.start_sd = sd as f32;
    }

    pub(crate) fn end(&mut self) {
        self.begin((0.0, 0.0, 0.0));
    }

    /// True if a measured charge has begun a pair.
    pub(crate) fn is_measured(&self) -> bool {
        self.start > 0.0 && self.start_sd <= 0.0
    }

    /// The pair that a charge of the same kind ends. The bias of a sensor is not in the depth
    /// between two of its values.
    pub(crate) fn pair(&self, (soc, counted, sd): (f64, f64, f64), step: f64) -> Option<Pair> {
        let (is_measured, sd) = (sd <= 0.0, sd as f32);
        let depth_sd = match is_measured {
            true => step as f32,
            false => (self.start_sd * self.start_sd + sd * sd).sqrt(),
        };
        (self.start > 0.0 && self.is_measured() == is_measured).then_some(Pair {
            depth: self.start - soc as f32,
            depth_sd,
            counted: self.start_counted - counted as f32,
        })
    }

    /// The charge after another `elapsed_ns` on the charger, if it is known. `None` if it was not
    /// charged all that time.
    pub(crate) fn charge(&mut self, soc: Option<f64>, elapsed_ns: Option<u64>) {
        let begun = elapsed_ns.filter(|_| self.tenth_from > 0.0);
        let Some(elapsed_ns) = begun else {
            let from = soc.filter(|_| elapsed_ns.is_some());
            (self.tenth_from, self.tenth_s) = (from.unwrap_or(0.0) as f32, 0.0);
            return;
        };
        self.tenth_s += (elapsed_ns as f64 * 1e-9) as f32;
        let from = f64::from(self.tenth_from);
        let tenth = |charge: f64| (charge * CHARGE_TENTHS as f64) as usize;
        let Some(soc) = soc.filter(|soc| tenth(*soc) > tenth(from)) else {
            return;
        };
        let (charged, seconds) = (soc - from, f64::from(self.tenth_s));
        if let Some(rate) = self.charge_rate.get_mut(tenth(from))
            && charged * CHARGE_TENTHS as f64 >= MIN_PART
        {
            // Saturates. 0 means unknown.
            let newest = (3.6e6 * charged / seconds).round().max(1.0) as u16;
            // A gauge that jumps must not make a charger fast. The mean of 1 and 2 would stay 1.
            let most = rate.saturating_mul(2).max(rate.saturating_add(2));
            *rate = if *rate == 0 { newest } else { u16::midpoint(*rate, newest.min(most)) };
        }
        (self.tenth_from, self.tenth_s) = (soc as f32, 0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gauge_that_jumps_makes_a_tenth_faster_by_half_and_a_charge_makes_it_slow_again() {
        let mut lessons = Lessons::continued([500; CHARGE_TENTHS]);
        lessons.charge(Some(0.31), Some(0));
        lessons.charge(Some(0.45), Some(1_000_000_000));
        assert_eq!(lessons.charge_rate[3], 750);
        lessons.charge(Some(0.5), Some(1_000_000_000));
        lessons.charge(None, None);
        lessons.charge(Some(0.3), Some(0));
        lessons.charge(Some(0.4), Some(720_000_000_000));
        assert_eq!(lessons.charge_rate[3], 625);
    }
}
