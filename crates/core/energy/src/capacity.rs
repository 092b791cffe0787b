//! The capacity of a battery, learned from what was drawn between two known charges.

use serde::{Deserialize, Serialize};

/// Least depth of a pair: less of the capacity says little about all of it.
pub const MIN_DEPTH: f32 = 0.3;
/// Weight of a pair beside that of the next newer one. A battery ages, and a fault ages it fast. The
/// last ten have 99 % of the weight. Chosen on the first half of 480 discharges of a robot
/// (`gopigo_discharges`), where .4 to .6 are alike.
const AGE: f32 = 0.6;
/// One pair moves the estimate by this share at most, and counts as this far off at most: a robot
/// that stood still for a day has drawn several batteries.
const MAX_STEP: f32 = 0.1;
const MAX_OFF: f32 = 0.2;
/// Prior of the scatter: as much as two pairs.
const PRIOR_PAIRS: f32 = 2.0;
const PRIOR_SD: f32 = 0.05;
/// Shares of the stated capacity within which every estimate is.
const BOUNDS: (f32, f32) = (0.1, 1.5);

/// A learned capacity, in the unit of what is drawn: energy, a share of the stated capacity, or
/// minutes. It is the *usable* one at the loads and temperatures seen.
///
/// A *pair* of known charges tells what was drawn between them. Pairs are weighted by depth and age.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Capacity {
    /// The best estimate. 0 before the first pair.
    value: f32,
    /// Sums over the pairs: weights, their squares, capacities, squares of what each was off the
    /// estimate before it, and variances of the depths.
    weights: f32,
    squares: f32,
    capacities: f32,
    offs: f32,
    depths: f32,
}

impl Capacity {
    /// The best estimate. `None` before the first pair.
    #[must_use]
    pub fn value(&self) -> Option<f32> {
        (self.value > 0.0).then_some(self.value)
    }

    /// Learns from an amount that was drawn while the charge fell by `depth`, a share whose standard
    /// deviation is `depth_sd`. `stated` is the capacity before the first pair. Returns whether the
    /// pair counts: deep enough, positive and finite.
    pub fn learn(&mut self, stated: f32, drawn: f32, (depth, depth_sd): (f32, f32)) -> bool {
        let capacity = drawn / depth;
        let counts = (MIN_DEPTH..=1.0).contains(&depth)
            && capacity > 0.0
            && capacity.is_finite()
            && (0.0..=1.0).contains(&depth_sd)
            && stated > 0.0
            && stated.is_finite();
        if !counts {
            return false;
        }
        let before = self.value().unwrap_or(stated);
        let off = (capacity / before - 1.0).clamp(-MAX_OFF, MAX_OFF);
        let add = |sum: f32, amount: f32| AGE * sum + depth * amount;
        *self = Self {
            value: 0.0,
            weights: add(self.weights, 1.0),
            squares: AGE * AGE * self.squares + depth * depth,
            capacities: add(self.capacities, before * (1.0 + off)),
            offs: add(self.offs, off * off),
            depths: add(self.depths, (depth_sd / depth).powi(2)),
        };
        let mean = self.capacities / self.weights;
        let moved = mean.clamp(before * (1.0 - MAX_STEP), before * (1.0 + MAX_STEP));
        self.value = moved.clamp(BOUNDS.0 * stated, BOUNDS.1 * stated);
        true
    }

    /// The battery is another one: what was learned of its size stays, and the pairs do not.
    pub fn exchange(&mut self) {
        *self = Self { value: self.value, ..Self::default() };
    }

    /// Relative standard deviation of the next pair about the estimate: by how far pairs were off,
    /// and by the step of the gauge. `None` before the first pair.
    #[must_use]
    pub fn relative_sd(&self) -> Option<f32> {
        self.value()?;
        let prior = PRIOR_PAIRS * PRIOR_SD * PRIOR_SD;
        // Without pairs, as after an exchange, the prior alone is known.
        if self.weights.is_nan() || self.weights <= 0.0 {
            return Some(PRIOR_SD * 2.0);
        }
        let pairs = self.weights * self.weights / self.squares;
        let variance = (pairs * self.offs / self.weights + prior) / (pairs + PRIOR_PAIRS);
        Some((variance + self.depths / self.weights / pairs).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// Whatever a gauge, a renumbered robot or a forged message says.
        #[test]
        fn one_pair_moves_the_estimate_by_a_tenth_and_all_of_them_stay_in_bounds(
            pairs in prop::collection::vec((any::<u32>(), any::<u32>(), any::<u32>()), 1..60),
            sane in prop::collection::vec((0.0f32..20.0, 0.0f32..1.2), 1..60),
        ) {
            let bits = pairs.into_iter().map(|(drawn, depth, sd)| {
                let [drawn, depth, sd] = [drawn, depth, sd].map(f32::from_bits);
                (drawn, depth, sd)
            });
            let sane = sane.into_iter().map(|(drawn, depth)| (drawn, depth, 0.01));
            let mut learned = Capacity::default();
            for (drawn, depth, sd) in bits.chain(sane) {
                let before = learned;
                let from = before.value().unwrap_or(10.0);
                let counts = learned.learn(10.0, drawn, (depth, sd));
                let is_deep = (0.3..=1.0).contains(&depth) && drawn > 0.0;
                prop_assert!(is_deep || !counts);
                prop_assert!(counts || learned == before);
                if let Some(value) = learned.value() {
                    prop_assert!((1.0..=15.0).contains(&value), "{}", value);
                    prop_assert!((value / from - 1.0).abs() < 0.1 + 1e-5, "{} to {}", from, value);
                    let sd = learned.relative_sd().unwrap();
                    prop_assert!(sd > 0.0 && sd < 3.5, "{}", sd);
                }
            }
        }
    }

    #[test]
    fn a_worn_battery_is_learned_within_its_interval_and_an_exchange_keeps_the_estimate() {
        let mut learned = Capacity::default();
        assert_eq!((learned.value(), learned.relative_sd()), (None, None));
        for cycle in 0..30 {
            let off = 1.0 + 0.02 * (cycle as f32 * 1.7).sin();
            assert!(learned.learn(10.0, 0.7 * 6.0 * off, (0.7, 0.01)));
        }
        let (value, sd) = (learned.value().unwrap(), learned.relative_sd().unwrap());
        assert!((value - 6.0).abs() < 0.15 && (0.02..0.06).contains(&sd), "{value} ± {sd}");
        learned.exchange();
        assert_eq!(learned.value(), Some(value));
        assert!(learned.relative_sd().unwrap() > sd);
        // Deep pairs count more than shallow ones.
        let mut mixed = Capacity::default();
        for (drawn, depth) in [(9.0, 1.0), (0.3 * 11.0, 0.3)] {
            assert!(mixed.learn(10.0, drawn, (depth, 0.0)));
        }
        assert!(mixed.value().unwrap() < 10.0, "{mixed:?}");
    }
}
