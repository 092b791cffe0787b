//! The linear baseline: AR(5), in older model files with velocities.

use crate::error::ModelError;
use crate::features::{FeatureSet, Features};
use crate::nan::canonical;

/// A forecast that is linear in the features: the last five readings (an autoregression, AR(5))
/// and, in older model files, the velocities. The trainer fits the autoregression by least squares
/// on the network's training rows. The model file includes it for forecasts that learn online.
///
/// ```
/// use joulebus_predictor::{FeatureSet, INPUTS, Linear};
///
/// let weights = [0.0; INPUTS];
/// let linear = Linear { feature_set: FeatureSet::PowerOnly, bias_w: 3.5, weights, r2: 0.0 };
/// assert!(linear.check().is_ok());
/// assert_eq!(linear.predict(&[1.0; INPUTS]), 3.5);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Linear {
    /// The features read, [`FeatureSet::Full`] or [`FeatureSet::PowerOnly`]. The weights of the
    /// others are 0.
    pub feature_set: FeatureSet,
    /// Forecast with all features 0, W.
    pub bias_w: f32,
    /// Weight of each feature, W per unit of the feature.
    pub weights: Features,
    /// Coefficient of determination on held-out data.
    pub r2: f32,
}

impl Linear {
    /// The largest feature set of the baseline of a network that reads `network`: the same without
    /// the reading age, whose effect is not linear.
    pub const fn feature_set_beside(network: FeatureSet) -> FeatureSet {
        if network.needs_command() { FeatureSet::Full } else { FeatureSet::PowerOnly }
    }

    /// Refuses numbers that are not finite, and weights of features that are not read.
    ///
    /// # Errors
    /// [`ModelError`] with the field, the found and the allowed value.
    pub fn check(&self) -> Result<(), ModelError> {
        for (field, value) in [("linear_bias_w", self.bias_w), ("linear_r2", self.r2)] {
            if !value.is_finite() {
                return Err(ModelError::field(field, &value, "finite"));
            }
        }
        for (feature, weight) in self.weights.iter().enumerate() {
            let read = self.feature_set.range().contains(&feature);
            if !(weight.is_finite() && (read || *weight == 0.0)) {
                let allowed = "finite, and 0 for features that are not read";
                return Err(ModelError::field("linear_weights", weight, allowed));
            }
        }
        Ok(())
    }

    /// The forecast of the next reading for one row, W: the bias, then each weight times its
    /// feature, added in order. It is not finite if one of them is not.
    pub fn predict(&self, row: &Features) -> f32 {
        let read = self.feature_set.range();
        canonical(read.fold(self.bias_w, |sum, at| sum + self.weights[at] * row[at]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::INPUTS;

    fn linear() -> Linear {
        let mut weights = [0.0; INPUTS];
        weights[6..11].copy_from_slice(&[0.5, 0.25, 0.125, 0.0625, 0.0625]);
        Linear { feature_set: FeatureSet::PowerOnly, bias_w: 1.0, weights, r2: 0.8 }
    }

    #[test]
    fn features_that_are_not_read_have_no_effect() {
        let mut row = [f32::NAN; INPUTS];
        row[6..11].fill(4.0);
        assert_eq!(linear().predict(&row), 5.0);
        for poison in [f32::NAN, -f32::NAN, f32::from_bits(0xffc0_1234)] {
            row[7] = poison;
            assert_eq!(linear().predict(&row).to_bits(), f32::NAN.to_bits());
        }
    }

    #[test]
    fn invalid_weights_are_refused() {
        assert!(linear().check().is_ok());
        for (at, weight) in [(0, 0.5), (0, f32::NAN), (11, 1.0), (7, f32::NAN), (8, f32::INFINITY)]
        {
            let mut broken = linear();
            broken.weights[at] = weight;
            assert!(broken.check().is_err(), "{weight} at {at}");
        }
        let (bias_w, r2) = (f32::NAN, f32::NAN);
        assert!(Linear { bias_w, ..linear() }.check().is_err());
        assert!(Linear { r2, ..linear() }.check().is_err());
    }
}
