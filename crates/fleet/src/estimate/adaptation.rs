//! Adaptation of the network's forecast to one robot: an offset and a gain.
//!
//! The adapted forecast is the network's times a gain, plus an offset. Both are fitted to the
//! robot's own readings by least squares with exponential forgetting (recursive least squares:
//! Ljung, "System identification", 2nd edition, 1999, section 11.2), and with a ridge towards a
//! gain of 1 and an offset of 0 that is not forgotten.
//!
//! Memory is bounded: 20 bytes per robot, and a reading's weight decays with every further one. A
//! robot at rest for hours causes no estimator windup, the known problem of forgetting, because the
//! ridge determines what its readings do not.

use serde::{Deserialize, Serialize};

/// Prior variance of the gain.
const GAIN_VARIANCE: f64 = 0.002;
/// Prior variance of the offset.
const OFFSET_VARIANCE: f64 = 0.07;
/// Forgetting factor of a reading's weight: half-life of 346 readings.
const FORGETTING: f32 = 0.998;
/// Limit of powers and residuals, standard deviations.
const MOST: f32 = 1e4;
/// Limit of the gain's distance from 1.
const GAIN_MOST: f64 = 3.0;

/// One robot's discounted sums. Powers are in units of the residual standard deviation in training.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Adaptation {
    count: f32,
    /// Sums of the network's forecasts, and of their squares.
    sum: f32,
    square: f32,
    /// Sums of the network's residuals, and of their products with its forecasts.
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

    /// Gain and offset.
    pub(crate) fn fit(&self) -> (f32, f32) {
        let (gain_ridge, offset_ridge) = (1.0 / GAIN_VARIANCE, 1.0 / OFFSET_VARIANCE);
        let square = f64::from(self.square) + gain_ridge;
        let count = f64::from(self.count) + offset_ridge;
        let [sum, product, residual] = [self.sum, self.product, self.residual].map(f64::from);
        // The determinant of the sums alone is at least 0, except for rounding.
        let determinant = (square * count - sum * sum).max(gain_ridge * offset_ridge);
        let gain = (product * count - residual * sum) / determinant;
        let gain = gain.clamp(-GAIN_MOST, GAIN_MOST);
        // The optimal offset for the clamped gain.
        let offset = (residual - gain * sum) / count;
        (1.0 + gain as f32, offset as f32)
    }

    /// The adapted forecast for the network's forecast `network`.
    pub(crate) fn forecast(&self, network: f32) -> f32 {
        let (gain, offset) = self.fit();
        gain * network.clamp(-MOST, MOST) + offset
    }

    /// Learns from the reading `reading` with the network's forecast `network`, both finite.
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
    fn offset_and_gain_are_estimated_and_tracked() {
        let mut adaptation = Adaptation::START;
        for (gain, offset) in [(1.0, 0.0), (1.3, -4.0), (0.8, 6.0)] {
            for step in 0..4_000u32 {
                let network = 30.0 + 8.0 * (step as f32 * 0.37).sin();
                adaptation.learn(network, gain * network + offset);
            }
            let (found, expected) = (adaptation.forecast(35.0), gain * 35.0 + offset);
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
    fn a_day_at_rest_causes_no_windup() {
        let mut adaptation = Adaptation::START;
        for _ in 0..30 * 3600 * 24 {
            adaptation.learn(30.0, 30.5);
        }
        assert!(
            (adaptation.forecast(30.0) - 30.5).abs() < 0.02,
            "{adaptation:?}"
        );
        // Far from the recent readings it stays close to the network.
        assert!(
            (adaptation.forecast(60.0) - 60.0).abs() < 2.0,
            "{adaptation:?}"
        );
    }

    proptest! {
        /// Against the same fit with sums over all readings, in double precision.
        #[test]
        fn gain_and_offset_equal_discounted_least_squares_with_a_ridge(
            rows in prop::collection::vec((20.0f32..60.0, -3.0f32..3.0), 1..300),
        ) {
            let mut adaptation = Adaptation::START;
            for (network, residual) in &rows {
                adaptation.learn(*network, network + residual);
            }
            let weight = |at: usize| f64::from(FORGETTING).powi((rows.len() - 1 - at) as i32);
            let cost = |gain: f64, offset: f64| {
                let errors = rows.iter().enumerate().map(|(at, (network, residual))| {
                    let (network, residual) = (f64::from(*network), f64::from(*residual));
                    weight(at) * (residual - (gain - 1.0) * network - offset).powi(2)
                });
                errors.sum::<f64>() + (gain - 1.0).powi(2) / GAIN_VARIANCE + offset.powi(2) / OFFSET_VARIANCE
            };
            let (gain, offset) = adaptation.fit();
            let (gain, offset) = (f64::from(gain), f64::from(offset));
            let least = cost(gain, offset);
            for (by_gain, by_level) in [(0.01, 0.0), (-0.01, 0.0), (0.0, 0.1), (0.0, -0.1), (0.01, -0.4), (-0.01, 0.4)] {
                prop_assert!(cost(gain + by_gain, offset + by_level) > least, "{} {}", gain, offset);
            }
        }

        #[test]
        fn the_forecast_stays_finite_and_bounded_for_any_input(
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
