//! How one robot differs from those that its model was trained on: a level and a gain.
//!
//! The adapted forecast is the network's times a gain, plus a level. Both are fitted to the robot's
//! own readings by least squares in which older readings count less (recursive least squares with
//! forgetting: Ljung, "System identification", 2nd edition, 1999, section 11.2), and in which the
//! network counts for a number of readings that is never forgotten (a ridge): a gain of 1, a level
//! of 0.
//!
//! Memory is bounded in every sense: 20 bytes a robot; a reading's weight falls by a factor with
//! every further one; and a robot that stands still for hours winds nothing up, the known fault of
//! forgetting, since the ridge decides what its readings do not.

use serde::{Deserialize, Serialize};

/// Variance of the gain, before anything is known of the robot.
const GAIN_DOUBT: f64 = 0.002;
/// The same of the level.
const LEVEL_DOUBT: f64 = 0.07;
/// What is left of a reading's weight after one more: half of it after 346.
const FORGETTING: f32 = 0.998;
/// Greatest power and residual that are believed, standard deviations.
const MOST: f32 = 1e4;
/// How far the gain may be from 1.
const GAIN_MOST: f64 = 3.0;

/// One robot's discounted sums. Powers are in standard deviations of the residuals in training.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Adaptation {
    count: f32,
    /// Of the network's forecasts, and of their squares.
    sum: f32,
    square: f32,
    /// Of the network's residuals, and of their products with its forecasts.
    residual: f32,
    product: f32,
}

impl Adaptation {
    pub(crate) const START: Self = Self {
        count: 0.0,
        sum: 0.0,
        square: 0.0,
        residual: 0.0,
        product: 0.0,
    };

    /// Gain and level.
    pub(crate) fn fit(&self) -> (f32, f32) {
        let (gain_ridge, level_ridge) = (1.0 / GAIN_DOUBT, 1.0 / LEVEL_DOUBT);
        let square = f64::from(self.square) + gain_ridge;
        let count = f64::from(self.count) + level_ridge;
        let [sum, product, residual] = [self.sum, self.product, self.residual].map(f64::from);
        // The sums' own determinant is not below 0 but for rounding.
        let determinant = (square * count - sum * sum).max(gain_ridge * level_ridge);
        let gain = (product * count - residual * sum) / determinant;
        let gain = gain.clamp(-GAIN_MOST, GAIN_MOST);
        // The best level beside a gain that is kept in its bounds.
        let level = (residual - gain * sum) / count;
        (1.0 + gain as f32, level as f32)
    }

    /// The forecast, where the network's is `network`.
    pub(crate) fn forecast(&self, network: f32) -> f32 {
        let (gain, level) = self.fit();
        gain * network.clamp(-MOST, MOST) + level
    }

    /// Learns that the reading was `reading` where the network's forecast was `network`, both
    /// finite.
    pub(crate) fn learn(&mut self, network: f32, reading: f32) {
        let network = network.clamp(-MOST, MOST);
        let residual = (reading - network).clamp(-MOST, MOST);
        for (sum, value) in [
            (&mut self.count, 1.0),
            (&mut self.sum, network),
            (&mut self.square, network * network),
            (&mut self.residual, residual),
            (&mut self.product, network * residual),
        ] {
            *sum = FORGETTING * *sum + value;
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_level_and_a_gain_are_found_and_followed_when_they_change() {
        let mut adaptation = Adaptation::START;
        for (gain, level) in [(1.0, 0.0), (1.3, -4.0), (0.8, 6.0)] {
            for step in 0..4_000u32 {
                let network = 30.0 + 8.0 * (step as f32 * 0.37).sin();
                adaptation.learn(network, gain * network + level);
            }
            let (found, expected) = (adaptation.forecast(35.0), gain * 35.0 + level);
            assert!(
                (found - expected).abs() < 0.4,
                "{found}, expected {expected}"
            );
            assert!(
                (adaptation.fit().0 - gain).abs() < 0.1,
                "{:?}",
                adaptation.fit()
            );
        }
    }

    #[test]
    fn standing_still_for_a_day_winds_nothing_up() {
        let mut adaptation = Adaptation::START;
        for _ in 0..30 * 3600 * 24 {
            adaptation.learn(30.0, 30.5);
        }
        assert!(
            (adaptation.forecast(30.0) - 30.5).abs() < 0.02,
            "{adaptation:?}"
        );
        // Of what it has not seen for so long it says nearly what the network says.
        assert!(
            (adaptation.forecast(60.0) - 60.0).abs() < 2.0,
            "{adaptation:?}"
        );
    }

    proptest! {
        /// Against the same fit by sums over all that has come, in double precision.
        #[test]
        fn gain_and_level_are_those_of_discounted_least_squares_with_a_ridge(
            rows in prop::collection::vec((20.0f32..60.0, -3.0f32..3.0), 1..300),
        ) {
            let mut adaptation = Adaptation::START;
            for (network, residual) in &rows {
                adaptation.learn(*network, network + residual);
            }
            let weight = |at: usize| f64::from(FORGETTING).powi((rows.len() - 1 - at) as i32);
            let cost = |gain: f64, level: f64| {
                let errors = rows.iter().enumerate().map(|(at, (network, residual))| {
                    let (network, residual) = (f64::from(*network), f64::from(*residual));
                    weight(at) * (residual - (gain - 1.0) * network - level).powi(2)
                });
                errors.sum::<f64>() + (gain - 1.0).powi(2) / GAIN_DOUBT + level.powi(2) / LEVEL_DOUBT
            };
            let (gain, level) = adaptation.fit();
            let (gain, level) = (f64::from(gain), f64::from(level));
            let least = cost(gain, level);
            for (by_gain, by_level) in [(0.01, 0.0), (-0.01, 0.0), (0.0, 0.1), (0.0, -0.1), (0.01, -0.4), (-0.01, 0.4)] {
                prop_assert!(cost(gain + by_gain, level + by_level) > least, "{} {}", gain, level);
            }
        }

        #[test]
        fn whatever_comes_the_forecast_stays_finite_and_bounded(
            rows in prop::collection::vec((-1e6f32..1e6, -1e6f32..1e6, 0u8..4), 1..400),
        ) {
            let mut adaptation = Adaptation::START;
            for (network, reading, context) in rows {
                let (network, reading) = match context {
                    0 => (network, reading),
                    1 => (network * 1e-4, reading * 1e-4),
                    2 => (40.0, reading * 1e-5),
                    _ => (network * 1e30, -network * 1e30),
                };
                adaptation.learn(network, reading);
                prop_assert!(adaptation.forecast(network).abs() <= 1e6, "{:?}", adaptation);
            }
        }
    }
}
