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
/// Prior of the scatter: as much as two pairs that are 5 % off.
const PRIOR_PAIRS: f32 = 2.0;
const PRIOR: f32 = PRIOR_PAIRS * 0.05 * 0.05;
const MAX_WEIGHT: f32 = 1.0 / (1.0 - AGE);
const MAX_SD: f32 = 1.0;
/// Shares of the stated capacity within which every estimate is.
const BOUNDS: (f32, f32) = (0.1, 1.5);

/// A learned capacity, in the unit of what is drawn: energy, a share of the stated capacity, or
/// minutes. It is the *usable* one at the loads and temperatures seen.
///
/// A *pair* of known charges tells what was drawn between them. Pairs are weighted by depth and age.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Capacity {
    /// The best estimate. 0 before the first pair.
    pub value: f32,
    /// Sum of the pairs' weights, at most 2.5. 0 before the first pair.
    pub weight: f32,
    /// Relative standard deviation of the next pair about the estimate: by how far pairs were off,
    /// and by the error of their depths. 0 before the first pair.
    pub sd: f32,
}

impl Capacity {
    /// The best estimate. `None` before the first pair.
    #[must_use]
    pub fn learned(&self) -> Option<f32> {
        (self.weight > 0.0).then_some(self.value)
    }

    /// True if it can have been learned where this was the stated capacity, up to rounding.
    #[must_use]
    pub fn is_sound(&self, stated: f32) -> bool {
        (0.999 * BOUNDS.0 * stated..=1.001 * BOUNDS.1 * stated).contains(&self.value)
            && (0.0..=MAX_WEIGHT).contains(&self.weight)
            && (0.0..=MAX_SD).contains(&self.sd)
            && self.weight > 0.0
    }

    /// Learns from an amount that was drawn while the charge fell by `depth`, a share whose standard
    /// deviation is `depth_sd`. `stated` is the capacity before the first pair. Returns whether the
    /// pair counts: deep enough, finite, and not of less than the smallest capacity, so that
    /// nobody can state a smaller one without drawing energy.
    pub fn learn(&mut self, stated: f32, drawn: f32, (depth, depth_sd): (f32, f32)) -> bool {
        let capacity = drawn / depth;
        let counts = (MIN_DEPTH..=1.0).contains(&depth)
            && capacity >= BOUNDS.0 * stated
            && capacity.is_finite()
            && (0.0..=1.0).contains(&depth_sd)
            && stated > 0.0
            && stated.is_finite();
        if !counts {
            return false;
        }
        let before = self.learned().unwrap_or(stated);
        let off = (capacity / before - 1.0).clamp(-MAX_OFF, MAX_OFF);
        let weight = AGE * self.weight + depth;
        let newest = depth / weight;
        let relative = depth_sd / depth;
        let scatter = self.scatter() + newest * (off * off + relative * relative - self.scatter());
        let moved = 1.0 + (newest * off).clamp(-MAX_STEP, MAX_STEP);
        let pairs = pairs(weight);
        *self = Self {
            value: (before * moved).clamp(BOUNDS.0 * stated, BOUNDS.1 * stated),
            weight: weight.min(MAX_WEIGHT),
            sd: ((pairs * scatter + PRIOR) / (pairs + PRIOR_PAIRS)).sqrt().min(MAX_SD),
        };
        true
    }

    /// Mean square of what pairs were off, by the deviation that contains it.
    fn scatter(&self) -> f32 {
        let pairs = pairs(self.weight);
        let of_pairs = self.sd * self.sd * (pairs + PRIOR_PAIRS) - PRIOR;
        if pairs > 0.0 { (of_pairs / pairs).max(0.0) } else { 0.0 }
    }
}

/// Number of full pairs that a sum of weights is worth, if weights fall by [`AGE`].
fn pairs(weight: f32) -> f32 {
    weight * (1.0 + AGE) / (2.0 - (1.0 - AGE) * weight)
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
                let from = before.learned().unwrap_or(10.0);
                let counts = learned.learn(10.0, drawn, (depth, sd));
                let is_deep = (0.3..=1.0).contains(&depth) && drawn > 0.0;
                prop_assert!(is_deep || !counts);
                prop_assert!(counts || learned == before);
                if let Some(value) = learned.learned() {
                    prop_assert!(learned.is_sound(10.0), "{:?}", learned);
                    prop_assert!((value / from - 1.0).abs() < 0.1 + 1e-5, "{} to {}", from, value);
                    prop_assert!(learned.sd > 0.0, "{:?}", learned);
                }
            }
        }
    }

    #[test]
    fn a_worn_battery_is_learned_within_its_interval_and_deep_pairs_count_more() {
        let mut learned = Capacity::default();
        assert_eq!(learned.learned(), None);
        for cycle in 0..30 {
            let off = 1.0 + 0.02 * (cycle as f32 * 1.7).sin();
            assert!(learned.learn(10.0, 0.7 * 6.0 * off, (0.7, 0.01)));
        }
        let Capacity { value, sd, .. } = learned;
        assert!((value - 6.0).abs() < 0.15 && (0.02..0.06).contains(&sd), "{value} ± {sd}");
        let mut mixed = Capacity::default();
        for (drawn, depth) in [(9.0, 1.0), (0.3 * 11.0, 0.3)] {
            assert!(mixed.learn(10.0, drawn, (depth, 0.0)));
        }
        assert!(mixed.value < 10.0, "{mixed:?}");
        // A gauge of three steps is believed less than a fine one.
        let [fine, coarse] = [0.01, 0.3].map(|sd| {
            let mut learned = Capacity::default();
            assert!(learned.learn(10.0, 6.0, (1.0, sd)));
            learned.sd
        });
        assert!(coarse > 1.5 * fine, "{fine} {coarse}");
    }
}
