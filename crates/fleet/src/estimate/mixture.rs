//! An online mixture of experts: weights per robot for persistence, the linear baseline, the
//! network and the adapted network.
//!
//! The forecast is the mean of the experts' forecasts, weighted by `exp(−η·L)`, where `L` is an
//! expert's discounted squared error so far. The learning rate η is not configured but adaptive:
//! `ln K / Δ`, where Δ is the cumulative mixability gap. This is AdaHedge (de Rooij, van Erven,
//! Grünwald, Koolen, "Follow the leader if you can, hedge if you must", JMLR 15, 2014, sections 2.1
//! and 5) with the loss of the mean forecast instead of the mean loss, and with discounting.
//!
//! **Guarantee**, for arbitrary readings and experts, adversarial ones included. Let λ < 1 be the
//! discount factor, `h_t` the squared error of the mixture at step t and `ℓ_{i,t}` that of expert
//! i. Then for every expert and at every time T
//!
//! ```text
//! Σ λ^(T−t) (h_t − ℓ_{i,t})  ≤  2 Δ_T                                                    (1)
//! Δ_T  ≤  max(Δ_0, 2 D² ln K / λ) + D²                                                   (2)
//! ```
//!
//! where D is the maximum distance between any two of reading and experts' forecasts in one step.
//! So the mean squared error over the memory of 1/(1−λ) readings exceeds that of the best expert by
//! at most `2 (1−λ) Δ_T`, independently of the number of readings.
//!
//! *Proof.* The mix loss `m_t = −(λ/η_t) ln Σ w_{i,t} exp(−η_t ℓ_{i,t} / λ)` telescopes: with the
//! scaled losses `λ^(−t) ℓ` and rates `λ^(t−1) η_t`, which never increase because Δ is a discounted
//! sum of non-negative terms, Σ of the scaled m is at most the scaled loss of any expert plus `ln
//! K` over the last rate (Lemma 2 there). The remainder, `h_t − m_t`, is at most the increment of
//! Δ. That is (1). The squared error is exp-concave at rates up to 1/(2 D²) (Cesa-Bianchi and
//! Lugosi, "Prediction, learning, and games", 2006, section 3.3), so that Δ stops increasing once
//! it has reached `2 D² ln K / λ`, and increases by at most D² at a time. That is (2).
//!
//! **Initial weights.** Not equal: as if each expert had had the mean squared error stated in the
//! model file, over [`TRUST`] readings. A robot with few readings, or with rare large changes, so
//! uses the prior from other robots; against expert i the right side of (1) grows by the initial
//! term `λ^T L_{i,0}`.
//!
//! Held readings differ from new ones: persistence is then exact. So weights are kept separately by
//! whether a new measurement is due, and (1) holds in each phase, over the readings of that phase.

use std::f32::consts::LN_2;

use joulebus_predictor::{Linear, Model};
use joulebus_settings::Online;
use serde::{Deserialize, Serialize};

use crate::estimate::adaptation::Adaptation;

/// Maximum number of experts: persistence, the linear baseline, the network, the adapted network.
pub(crate) const EXPERTS: usize = 4;
/// A new measurement is due (or due is unknown), or none is.
const PHASES: usize = 2;

/// Weight of the scores in the model file, in readings.
const TRUST: f32 = 40.0;
/// Maximum initial squared error, as a multiple of the network's.
const WORST: f32 = 10.0;
/// The discount factor λ: half-life of 693 readings.
const MEMORY: f32 = 0.999;
/// Lower bound of Δ, squared standard deviations: keeps the learning rate finite.
const FLOOR: f32 = 2.0;
/// Natural logarithm of the number of experts.
const LOG: [f32; EXPERTS + 1] = [0.0, 0.0, LN_2, 1.098_612_3, 2.0 * LN_2];
/// Limit of errors, standard deviations: without it, one absurd forecast would turn the sums into
/// NaN permanently.
const ERROR_MAX: f32 = 1e6;

/// The experts of a platform, prepared for the tick.
#[derive(Debug, Clone)]
pub(crate) struct Blending {
    pub linear: Option<Linear>,
    /// Standard deviation of the residuals in training, W.
    sigma_w: f32,
    online: Online,
    /// Initial squared error of each expert above that of the best; infinite for a missing expert.
    start: [f32; EXPERTS],
}

impl Blending {
    /// `None` where only the network is configured. `sigma_w` is above 0.
    pub(crate) fn new(online: Online, model: &Model, sigma_w: f32) -> Option<Self> {
        let (Online { mixture, adapt }, Model::Network(network)) = (online, model) else {
            return None;
        };
        if !(mixture || adapt) {
            return None;
        }
        let (scores, linear) = (&network.card().scores, model.linear());
        let unexplained = |r2: f32| {
            let ratio = (1.0 - r2) / (1.0 - scores.network_r2).max(f32::MIN_POSITIVE);
            // Scores of 1, or on constant data, do not transfer to other data.
            if ratio.is_finite() {
                ratio.clamp(0.0, WORST)
            } else {
                1.0
            }
        };
        let error = [
            unexplained(scores.persistence_r2),
            linear.map_or(f32::INFINITY, |linear| unexplained(linear.r2)),
            1.0,
            if adapt { 1.0 } else { f32::INFINITY },
        ];
        let best = error.into_iter().fold(f32::INFINITY, f32::min);
        Some(Self {
            linear: linear.copied(),
            sigma_w,
            online,
            start: error.map(|error| TRUST * (error - best)),
        })
    }
}

/// State of a robot's online learning.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Learned {
    /// Weights of persistence, the linear baseline, the network and the adapted network where a new
    /// measurement is due: not negative, with sum 1, 0 for an expert that the platform does not
    /// have. `None` without a mixture.
    pub weights: Option<[f32; 4]>,
    /// The same where the next reading will be held.
    pub weights_held: Option<[f32; 4]>,
    /// Gain on the network's forecast; 1 without adaptation.
    pub gain: f32,
    /// Offset added to it, W; 0 without adaptation.
    pub level_w: f32,
}

/// One robot's experts: their forecasts and their losses.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Blend {
    records: [Record; PHASES],
    adaptation: Adaptation,
    /// Forecasts of the next reading, W; meaningless where the robot has no forecast.
    forecasts_w: [f32; EXPERTS],
    /// The phase that they are for.
    phase: u8,
}

impl Blend {
    /// Of no robot.
    pub(crate) const NONE: Self = Self {
        records: [Record {
            loss: [0.0; EXPERTS],
            cost: FLOOR,
        }; PHASES],
        adaptation: Adaptation::START,
        forecasts_w: [f32::NAN; EXPERTS],
        phase: 0,
    };

    pub(crate) fn new(blending: &Blending) -> Self {
        let record = Record {
            loss: blending.start,
            cost: FLOOR,
        };
        Self {
            records: [record; PHASES],
            ..Self::NONE
        }
    }

    /// The robot's forecast, W, and its experts', from the network's forecast `network_w`, finite,
    /// and that of the linear baseline, if there is one, `linear_w`; `due`: whether a new
    /// measurement is due.
    pub(crate) fn forecast(
        &self,
        blending: &Blending,
        [last_w, linear_w, network_w]: [f32; 3],
        due: bool,
    ) -> (f32, [f32; EXPERTS]) {
        let adapted_w = blending.sigma_w * self.adaptation.forecast(network_w / blending.sigma_w);
        let forecasts_w = [last_w, linear_w, network_w, adapted_w]
            .map(|watts| if watts.is_finite() { watts } else { network_w });
        let forecast_w = if blending.online.mixture {
            dot(&self.records[phase(due)].weights(), &forecasts_w)
        } else {
            adapted_w
        };
        (forecast_w, forecasts_w)
    }

    /// Stores the experts' forecasts for the next sample.
    pub(crate) fn expect(&mut self, forecasts_w: [f32; EXPERTS], due: bool) {
        self.forecasts_w = forecasts_w;
        self.phase = phase(due) as u8;
    }

    /// Learns from the reading, W, of the stored forecasts.
    pub(crate) fn learn(&mut self, blending: &Blending, reading_w: f32) {
        let sigma_w = blending.sigma_w;
        if blending.online.mixture {
            let error = self.forecasts_w.map(|forecast_w| {
                ((forecast_w - reading_w) / sigma_w).clamp(-ERROR_MAX, ERROR_MAX)
            });
            self.records[usize::from(self.phase) % PHASES].learn(error);
        }
        if blending.online.adapt {
            let [_, _, network_w, _] = self.forecasts_w;
            self.adaptation
                .learn(network_w / sigma_w, reading_w / sigma_w);
        }
    }

    pub(crate) fn learned(&self, blending: &Blending) -> Learned {
        let (gain, level) = self.adaptation.fit();
        let weights = |phase: usize| {
            let record: &Record = &self.records[phase];
            blending.online.mixture.then(|| record.weights())
        };
        Learned {
            weights: weights(0),
            weights_held: weights(1),
            gain,
            level_w: level * blending.sigma_w,
        }
    }
}

fn phase(due: bool) -> usize {
    usize::from(!due)
}

/// The experts' losses in one phase. Errors are squared, in units of the training's residuals.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Record {
    /// Discounted squared error of each expert above that of the best; infinite for a missing
    /// expert.
    loss: [f32; EXPERTS],
    /// Δ, the cumulative mixability gap.
    cost: f32,
}

impl Record {
    /// The weight of each expert: not negative, with sum 1, and 0 for a missing expert.
    fn weights(&self) -> [f32; EXPERTS] {
        let rate = self.rate();
        let raw = self.loss.map(|loss| libm::expf(-rate * loss));
        // The best has a loss of 0 and a raw weight of 1: the sum is at least 1.
        let sum = (raw[0] + raw[1]) + (raw[2] + raw[3]);
        raw.map(|raw| raw / sum)
    }

    /// Learns each expert's error, in standard deviations; that of a missing expert must only be
    /// finite.
    fn learn(&mut self, error: [f32; EXPERTS]) {
        let weights = self.weights();
        let loss = error.map(|error| error * error);
        let mixed = dot(&weights, &error);
        let cost = mixed * mixed - self.mix_loss(&loss);
        self.cost = (MEMORY * self.cost + cost.max(0.0)).max(FLOOR);
        for (sum, loss) in self.loss.iter_mut().zip(loss) {
            *sum = MEMORY * *sum + loss;
        }
        let best = self.loss.into_iter().fold(f32::INFINITY, f32::min);
        self.loss = self.loss.map(|loss| loss - best);
    }

    /// −(λ/η) ln Σ w exp(−η ℓ / λ), computed from the losses: a weight may underflow and yet be
    /// decisive.
    fn mix_loss(&self, loss: &[f32; EXPERTS]) -> f32 {
        let rate = self.rate();
        let sum = |loss: [f32; EXPERTS], least: f32| {
            let raw = loss.map(|loss| libm::expf(-rate * (loss - least)));
            libm::logf((raw[0] + raw[1]) + (raw[2] + raw[3]))
        };
        let mut after = self.loss;
        for (sum, loss) in after.iter_mut().zip(loss) {
            *sum += loss / MEMORY;
        }
        let least = after.into_iter().fold(f32::INFINITY, f32::min);
        MEMORY * (least - (sum(after, least) - sum(self.loss, 0.0)) / rate)
    }

    /// η; there are at least two experts.
    fn rate(&self) -> f32 {
        let there = self.loss.iter().filter(|loss| loss.is_finite()).count();
        LOG[there] / self.cost
    }
}

fn dot(a: &[f32; EXPERTS], b: &[f32; EXPERTS]) -> f32 {
    (a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The quantities of the bound, summed in double precision.
    struct Account {
        regret: [f64; EXPERTS],
        largest: f64,
    }

    impl Account {
        fn new(record: &Record) -> Self {
            Self {
                regret: record.loss.map(|start| -f64::from(start)),
                largest: 0.0,
            }
        }

        fn take(&mut self, weights: [f32; EXPERTS], error: [f32; EXPERTS]) {
            let mixed = f64::from(dot(&weights, &error));
            for (place, error) in error.iter().map(|error| f64::from(*error)).enumerate() {
                let regret = &mut self.regret[place];
                *regret = f64::from(MEMORY) * *regret + (mixed * mixed - error * error);
                if weights[place] > 0.0 {
                    self.largest = self.largest.max(error * error);
                }
            }
        }

        /// Checks (1) and (2). `there`: number of experts.
        fn check(&self, record: &Record, there: usize) -> Result<(), TestCaseError> {
            let cost = f64::from(record.cost);
            let rounding = 1e-4 * (1.0 + self.largest);
            for (place, regret) in self.regret.iter().enumerate() {
                if record.loss[place].is_finite() {
                    prop_assert!(
                        *regret <= 2.0 * cost + rounding,
                        "{}: {} {:?}",
                        place,
                        regret,
                        record
                    );
                }
            }
            let most = 2.0 * self.largest * f64::from(LOG[there]) / f64::from(MEMORY);
            prop_assert!(
                cost <= most.max(f64::from(FLOOR)) + self.largest + rounding,
                "{:?}",
                record
            );
            Ok(())
        }
    }

    fn fresh(there: usize, start: [f32; EXPERTS]) -> Record {
        let loss = std::array::from_fn(|place| {
            if place < there {
                start[place]
            } else {
                f32::INFINITY
            }
        });
        Record { loss, cost: FLOOR }
    }

    proptest! {
        /// Arbitrary experts and readings, of any size, that change between extremes.
        #[test]
        fn the_regret_stays_below_its_bound_for_any_input(
            there in 2usize..=EXPERTS,
            start in prop::array::uniform4(0.0f32..100.0),
            steps in prop::collection::vec(
                (prop::array::uniform4(-1.0f32..1.0), -2i32..3, any::<[bool; EXPERTS]>()), 1..600),
        ) {
            let mut record = fresh(there, start);
            let best = record.loss.into_iter().fold(f32::INFINITY, f32::min);
            record.loss = record.loss.map(|loss| loss - best);
            let mut account = Account::new(&record);
            for (error, exponent, perfect) in steps {
                let scale = 10f32.powi(exponent);
                let error = std::array::from_fn(|place| {
                    if perfect[place] || place >= there { 0.0 } else { scale * error[place] }
                });
                account.take(record.weights(), error);
                record.learn(error);
                account.check(&record, there)?;
            }
        }

        /// An adversary that knows the weights: the reading is always where the mixture is worst
        /// relative to the best expert so far, and the best expert alternates.
        #[test]
        fn the_regret_stays_below_its_bound_against_an_adversary(
            spread in 0.01f32..30.0, turn in 1usize..400, there in 2usize..=EXPERTS,
        ) {
            let mut record = fresh(there, [0.0; EXPERTS]);
            let mut account = Account::new(&record);
            let forecasts = [-spread, spread, -0.3 * spread, 0.7 * spread];
            for step in 0..3_000 {
                let weights = record.weights();
                let mixed = dot(&weights, &forecasts);
                let favoured = forecasts[step / turn % there];
                let reading = if step % 2 == 0 { favoured } else { -spread.copysign(mixed) };
                let error = std::array::from_fn(|place| {
                    if place < there { forecasts[place] - reading } else { 0.0 }
                });
                account.take(weights, error);
                record.learn(error);
            }
            account.check(&record, there)?;
        }
    }

    /// Complements the tests above, which a mixture that learned nothing would pass if the bound
    /// were loose.
    #[test]
    fn the_weight_moves_to_the_best_expert_and_back() {
        let mut record = fresh(EXPERTS, [0.0; EXPERTS]);
        for best in [0, 3, 1, 2] {
            for step in 0..3_000u32 {
                let noise = (step as f32 * 2.3).sin();
                let error =
                    std::array::from_fn(|place| noise + if place == best { 0.0 } else { 1.0 });
                record.learn(error);
            }
            assert!(record.weights()[best] > 0.95, "{best}: {record:?}");
        }
    }

    #[test]
    fn absurd_values_have_no_lasting_effect() {
        let mut record = fresh(3, [0.0; EXPERTS]);
        record.learn([ERROR_MAX, -ERROR_MAX, 0.0, 0.0]);
        record.learn([ERROR_MAX, ERROR_MAX, ERROR_MAX, 0.0]);
        for _ in 0..60_000 {
            record.learn([1.0, 0.1, 2.0, 0.0]);
            let sum: f32 = record.weights().iter().sum();
            assert!((sum - 1.0).abs() < 1e-5, "{record:?}");
        }
        assert!(
            record.weights()[1] > 0.9 && record.weights()[3] == 0.0,
            "{record:?}"
        );
    }
}
