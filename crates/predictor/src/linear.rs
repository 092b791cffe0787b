//! The linear baseline: AR(5) and velocities.

use crate::{FEATURES, FeatureSet, Features, ModelError};

/// A forecast that is linear in the features: the last five readings (an autoregression, AR(5)) and,
/// where they are read, the velocities. The trainer fits it by least squares on the rows that the
/// network learns from; a model file carries it so that the tick can weigh it against the network.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Linear {
    /// The features that are read; the weights of the others are 0.
    pub feature_set: FeatureSet,
    /// Forecast for features that are all 0, W.
    pub bias_w: f32,
    /// Weight of each feature, W per unit of the feature.
    pub weights: Features,
}

impl Linear {
    /// Refuses numbers that are not finite, and weights of features that are not read.
    ///
    /// # Errors
    /// [`ModelError`] names the field, what was found and what is allowed.
    pub fn check(&self) -> Result<(), ModelError> {
        if !self.bias_w.is_finite() {
            return Err(ModelError::field("linear_bias_w", &self.bias_w, "finite"));
        }
        let (unread, read) = self.weights.split_at(self.feature_set.first());
        let strange = unread.iter().find(|weight| !(**weight == 0.0));
        let broken = read.iter().find(|weight| !weight.is_finite());
        match (strange, broken) {
            (Some(weight), _) => {
                let allowed = "0 for features that are not read";
                Err(ModelError::field("linear_weights", weight, allowed))
            }
            (None, Some(weight)) => Err(ModelError::field("linear_weights", weight, "finite")),
            (None, None) => Ok(()),
        }
    }

    /// The forecast of the next reading for one row, W: the bias, and then each weight times its
    /// feature, added in order. Not finite where one of them is not.
    pub fn predict(&self, row: &Features) -> f32 {
        let read = self.feature_set.first()..FEATURES;
        read.fold(self.bias_w, |sum, at| sum + self.weights[at] * row[at])
    }

    /// As [`Linear::predict`], with one column for each feature: `features[f][i]` is feature `f` of
    /// row `i`. The same bits. Columns of features that are not read may be empty; rows past the
    /// shortest of the slices that are used are left alone.
    pub fn predict_columns(&self, features: [&[f32]; FEATURES], forecasts_w: &mut [f32]) {
        forecasts_w.fill(self.bias_w);
        let read = features.iter().zip(self.weights);
        for (column, weight) in read.skip(self.feature_set.first()) {
            for (forecast_w, value) in forecasts_w.iter_mut().zip(*column) {
                *forecast_w += weight * value;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn linear() -> Linear {
        let mut weights = [0.0; FEATURES];
        weights[6..].copy_from_slice(&[0.5, 0.25, 0.125, 0.0625, 0.0625]);
        Linear {
            feature_set: FeatureSet::PowerOnly,
            bias_w: 1.0,
            weights,
        }
    }

    #[test]
    fn what_is_not_read_does_not_matter() {
        let mut row = [f32::NAN; FEATURES];
        row[6..].fill(4.0);
        assert_eq!(linear().predict(&row), 5.0);
        row[7] = f32::NAN;
        assert!(linear().predict(&row).is_nan());
    }

    #[test]
    fn weights_that_make_no_sense_are_refused() {
        assert!(linear().check().is_ok());
        for (at, weight) in [(0, 0.5), (0, f32::NAN), (7, f32::NAN), (8, f32::INFINITY)] {
            let mut broken = linear();
            broken.weights[at] = weight;
            assert!(broken.check().is_err(), "{weight} at {at}");
        }
        let bias_w = f32::NAN;
        assert!(Linear { bias_w, ..linear() }.check().is_err());
    }
}
