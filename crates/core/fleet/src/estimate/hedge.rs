//! Weights for forecasters by their squared errors: AdaHedge with a memory.
//!
//! Members are weighted by `exp(−η·L)`, where `L` is a member's squared error so far, older errors
//! counting less. The learning rate is adapted, not configured: `η = ln K / Δ`, where Δ is what
//! averaging has cost so far (de Rooij, van Erven, Grünwald, Koolen, "Follow the leader if you can,
//! hedge if you must", JMLR 15, 2014, sections 2.1 and 5), with the loss of the mean forecast in
//! place of the mean loss, and with a memory.
//!
//! **Bound**, for any readings and members, an adversary's included. Let λ < 1 be the memory's
//! factor, `h_t` the squared error of the weighted mean at step t, `ℓ_{i,t}` that of member i, W²,
//! and `L_{i,0}` its initial loss above that of the best. For every member and at every time T
//!
//! ```text
//! Σ λ^(T−t) (h_t − ℓ_{i,t})  ≤  2 Δ_T + λ^T L_{i,0}                                      (1)
//! Δ_T  ≤  max(F, 2 D² ln K / λ) + D²                                                     (2)
//! ```
//!
//! where D is the largest distance between any two of reading and members' forecasts in one step
//! and F the largest lower bound that Δ was given. So the mean squared error over a memory of
//! 1/(1−λ) readings exceeds that of the best member by at most `2 (1−λ) Δ_T` plus the initial term,
//! however many readings there are.
//!
//! *Proof.* The mix loss `m_t = −(λ/η_t) ln Σ w_{i,t} exp(−η_t ℓ_{i,t} / λ)` telescopes: with the
//! scaled losses `λ^(−t) ℓ` and rates `λ^(t−1) η_t`, which never increase because Δ is a discounted
//! sum of non-negative terms that a lower bound only raises, Σ of the scaled m is at most the
//! scaled loss of any member plus `ln K` over the last rate (Lemma 2 there). What remains,
//! `h_t − m_t`, is at most what Δ takes up. That is (1). The squared error is exp-concave at rates
//! up to 1/(2 D²) (Cesa-Bianchi and Lugosi, "Prediction, learning, and games", 2006, section 3.3),
//! so that Δ takes up nothing once it has reached `2 D² ln K / λ`, and never more than D² at a
//! time. That is (2).

use std::f32::consts::{LN_2, LOG2_E};

use crate::layout::lanes::each;

/// Members: the last reading, the network, the confident and the sceptical stack.
pub(crate) const MEMBERS: usize = 4;

/// The memory λ: an error's weight halves every 231 readings.
pub(crate) const MEMORY: f32 = 0.997;
/// Limit of an error, W: without it one absurd forecast would turn the sums into infinity.
const MAX_ERROR_W: f32 = 1e6;

/// The losses on which the weights are based, W². A member that does not take part has an infinite
/// loss.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Hedge {
    /// Discounted squared error of the last reading, the network and the sceptical stack, relative
    /// to the confident stack's.
    pub above: [f32; MEMBERS - 1],
    /// Δ. 0 before the first error.
    pub cost: f32,
    /// True if all members take part, or the last reading and one stack.
    pub of_all: bool,
}

impl Hedge {
    /// ln K.
    #[inline(always)]
    pub(crate) fn log(&self) -> f32 {
        if self.of_all { 2.0 * LN_2 } else { LN_2 }
    }

    /// Not negative, 1 in all.
    #[inline(always)]
    pub(crate) fn weights(&self) -> [f32; MEMBERS] {
        let rate = self.log() / self.cost;
        let raw = each(self.losses(), |loss| exp(-rate * loss));
        // The best has a loss of 0 and a raw weight of 1.
        let share = 1.0 / sum(&raw);
        each(raw, |raw| raw * share)
    }

    /// The weights of the last reading and the confident stack where no other member takes part:
    /// the same bits as [`Hedge::weights`], in which an absent member has an infinite loss.
    #[inline(always)]
    pub(crate) fn weights_of_two(&self) -> [f32; 2] {
        let (rate, last) = (self.log() / self.cost, self.above[0]);
        let (least, absent) = (last.min(0.0), exp(f32::NEG_INFINITY));
        let raw = [exp(-rate * (last - least)), exp(-rate * -least)];
        let share = 1.0 / ((raw[0] + absent) + (raw[1] + absent));
        [raw[0] * share, raw[1] * share]
    }

    /// Learns each member's error, W. Of one that does not take part it must only be finite.
    /// `floor`: Δ is at least this, W², above 0.
    #[inline(always)]
    pub(crate) fn learn(&mut self, error_w: [f32; MEMBERS], floor: f32) {
        let error = each(error_w, |error| error.clamp(-MAX_ERROR_W, MAX_ERROR_W));
        let loss = each(error, |error| error * error);
        let mixed = dot(&self.weights(), &error);
        let cost = mixed * mixed - self.mix_loss(&loss);
        self.cost = (MEMORY * self.cost + cost.max(0.0)).max(floor);
        self.above = [
            MEMORY * self.above[0] + (loss[0] - loss[2]),
            MEMORY * self.above[1] + (loss[1] - loss[2]),
            MEMORY * self.above[2] + (loss[3] - loss[2]),
        ];
    }

    /// Loss of each member, relative to the best one's.
    #[inline(always)]
    fn losses(&self) -> [f32; MEMBERS] {
        let [last, network, sceptic] = self.above;
        let least = last.min(network).min(sceptic).min(0.0);
        [last - least, network - least, -least, sceptic - least]
    }

    /// The confident stack's part of both stacks' weight.
    #[inline(always)]
    pub(crate) fn confidence(&self) -> f32 {
        let above = self.above[2];
        let raw = exp(-(self.log() / self.cost) * above.abs());
        let larger = 1.0 / (1.0 + raw);
        if above >= 0.0 { larger } else { raw * larger }
    }

    /// −(λ/η) ln Σ w exp(−η ℓ / λ), from the losses themselves: a weight may underflow and
    /// yet decide.
    #[inline(always)]
    fn mix_loss(&self, loss: &[f32; MEMBERS]) -> f32 {
        const BACK: f32 = 1.0 / MEMORY;
        let rate = self.log() / self.cost;
        // 1/η: divisions take longer than anything else here.
        let per_log = if self.of_all { 0.5 / LN_2 } else { 1.0 / LN_2 };
        let before = self.losses();
        let after = [
            before[0] + loss[0] * BACK,
            before[1] + loss[1] * BACK,
            before[2] + loss[2] * BACK,
            before[3] + loss[3] * BACK,
        ];
        let least = (after[0].min(after[1])).min(after[2].min(after[3]));
        let mixed = |losses: [f32; MEMBERS], least: f32| {
            sum(&each(losses, |loss| exp(-rate * (loss - least))))
        };
        let shrunk = ln_ratio(mixed(after, least), mixed(before, 0.0));
        MEMORY * (least - shrunk * (self.cost * per_log))
    }
}

#[inline(always)]
pub(crate) fn dot(a: &[f32; MEMBERS], b: &[f32; MEMBERS]) -> f32 {
    (a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3])
}

#[inline(always)]
fn sum(of: &[f32; MEMBERS]) -> f32 {
    (of[0] + of[1]) + (of[2] + of[3])
}

/// e^x for x ≤ 0, within 3e-7 of it. 2e-35 below −80. The same bits on every machine, and without
/// branches, unlike a C library's.
#[inline(always)]
fn exp(x: f32) -> f32 {
    /// 1.5 × 2²³: adding it rounds to a whole number, which then stands in the last bits.
    const ROUND: f32 = 12_582_912.0;
    let scaled = x.max(-80.0) * LOG2_E;
    let rounded = scaled + ROUND;
    let rest = (scaled - (rounded - ROUND)) * LN_2;
    let series = 1.0
        + rest
            * (1.0
                + rest
                    * (0.5
                        + rest
                            * (1.0 / 6.0
                                + rest
                                    * (1.0 / 24.0 + rest * (1.0 / 120.0 + rest * (1.0 / 720.0))))));
    let power = (rounded.to_bits() << 23).wrapping_add(1.0f32.to_bits());
    series * f32::from_bits(power)
}

/// The natural logarithm of a / b, both from 1 to 4, within 6e-7: 2 artanh((a − b) / (a + b)).
#[inline(always)]
fn ln_ratio(a: f32, b: f32) -> f32 {
    let s = (a - b) / (a + b);
    let q = s * s;
    let tiny = 1.0 / 19.0 + q * (1.0 / 21.0 + q * (1.0 / 23.0 + q * (1.0 / 25.0)));
    let small = 1.0 / 13.0 + q * (1.0 / 15.0 + q * (1.0 / 17.0 + q * tiny));
    let series = 1.0
        + q * (1.0 / 3.0
            + q * (1.0 / 5.0 + q * (1.0 / 7.0 + q * (1.0 / 9.0 + q * (1.0 / 11.0 + q * small)))));
    2.0 * s * series
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The quantities in the bound, summed in double precision.
    struct Account {
        regret: [f64; MEMBERS],
        largest: f64,
        floor: f64,
    }

    impl Account {
        fn new(hedge: &Hedge) -> Self {
            Self {
                regret: hedge.losses().map(|start| -f64::from(start)),
                largest: 0.0,
                floor: f64::from(hedge.cost),
            }
        }

        fn take(&mut self, hedge: &Hedge, error: [f32; MEMBERS], floor: f32) {
            let weights = hedge.weights();
            let mixed = f64::from(dot(&weights, &error));
            for place in 0..MEMBERS {
                let error = f64::from(error[place]);
                let regret = &mut self.regret[place];
                *regret = f64::from(MEMORY) * *regret + (mixed * mixed - error * error);
                if hedge.losses()[place].is_finite() {
                    // Between two members, or one and the reading.
                    self.largest = self.largest.max(4.0 * error * error);
                }
            }
            self.floor = self.floor.max(f64::from(floor));
        }

        /// Checks (1) and (2).
        fn check(&self, hedge: &Hedge) -> Result<(), TestCaseError> {
            let cost = f64::from(hedge.cost);
            let rounding = 1e-3 * (self.floor + self.largest);
            for (place, regret) in self.regret.iter().enumerate() {
                if hedge.losses()[place].is_finite() {
                    prop_assert!(*regret <= 2.0 * cost + rounding, "{place}: {regret} {hedge:?}");
                }
            }
            let most = 2.0 * self.largest * f64::from(hedge.log()) / f64::from(MEMORY);
            prop_assert!(cost <= most.max(self.floor) + self.largest + rounding, "{hedge:?}");
            Ok(())
        }
    }

    fn fresh(of_all: bool, start: [f32; 3]) -> Hedge {
        Hedge {
            above: if of_all { start } else { [start[0], f32::INFINITY, f32::INFINITY] },
            cost: 2.0,
            of_all,
        }
    }

    proptest! {
        /// Arbitrary members and readings of arbitrary size.
        #[test]
        fn the_regret_stays_below_its_bound_for_any_readings(
            of_all in any::<bool>(),
            start in prop::array::uniform3(0.0f32..100.0),
            steps in prop::collection::vec(
                (prop::array::uniform4(-1.0f32..1.0), -2i32..3), 1..300
            ),
        ) {
            let mut hedge = fresh(of_all, start);
            let mut account = Account::new(&hedge);
            for (error, exponent) in steps {
                let error = error.map(|error| error * 10f32.powi(exponent));
                account.take(&hedge, error, 2.0);
                hedge.learn(error, 2.0);
                account.check(&hedge)?;
                let [last, _, stack, _] = hedge.weights();
                if !of_all {
                    prop_assert_eq!(hedge.weights_of_two().map(f32::to_bits), [last, stack].map(f32::to_bits));
                }
            }
        }

        /// An adversary that knows the weights: whichever member is trusted most is wrong next, at
        /// a distance that makes the weights change sides again.
        #[test]
        fn the_regret_stays_below_its_bound_against_an_adversary(
            of_all in any::<bool>(),
            distance in 0.01f32..30.0,
            wait in 1usize..400,
        ) {
            let mut hedge = fresh(of_all, [0.0; 3]);
            let mut account = Account::new(&hedge);
            for step in 0..3_000 {
                let weights = hedge.weights();
                let trusted = (0..MEMBERS).max_by(|a, b| weights[*a].total_cmp(&weights[*b]));
                let mut error = [0.0; MEMBERS];
                // In between all are right, so that the memory fades and trust is equal again.
                if step % (wait + 40) < 40 {
                    error[trusted.unwrap_or(0)] = distance;
                }
                account.take(&hedge, error, 1e-3);
                hedge.learn(error, 1e-3);
                account.check(&hedge)?;
            }
        }

        #[test]
        fn exp_and_ln_are_as_exact_as_they_state(x in -80.0f32..0.0, a in 1.0f32..4.0, b in 1.0f32..4.0) {
            let exact = f64::from(x).exp();
            prop_assert!((f64::from(exp(x)) / exact - 1.0).abs() < 3e-7 * (1.0 + f64::from(-x)));
            let exact = (f64::from(a) / f64::from(b)).ln();
            prop_assert!((f64::from(ln_ratio(a, b)) - exact).abs() < 6e-7);
        }
    }

    #[test]
    fn the_best_member_is_found_and_an_absent_one_has_no_weight() {
        let mut hedge = fresh(false, [0.0; 3]);
        for _ in 0..200 {
            hedge.learn([2.0, 0.0, 0.1, 0.0], 0.01);
        }
        let [last, network, stack, sceptic] = hedge.weights();
        assert!(last < 1e-6 && network.max(sceptic) < 1e-30 && stack > 0.999, "{hedge:?}");
        assert_eq!((exp(0.0), ln_ratio(1.0, 1.0)), (1.0, 0.0));
        assert!(exp(f32::NEG_INFINITY) < 1e-34);
    }

    #[test]
    fn absurd_errors_leave_it_finite() {
        let mut hedge = fresh(true, [0.0; 3]);
        for step in 0..2_000 {
            let error = if step % 3 == 0 { 1e30 } else { -1e-30 };
            hedge.learn([error, -error, 1.0, -1.0], 1e-4);
            let weights = hedge.weights();
            assert!((0.0..=1.0).contains(&hedge.confidence()), "{hedge:?}");
            assert!(weights.iter().all(|weight| (0.0..=1.0).contains(weight)), "{hedge:?}");
        }
    }
}
