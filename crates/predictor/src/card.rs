//! Where a model comes from and how good it was.

use crate::error::ModelError;
use crate::features::{FeatureSet, Features};
use crate::linear::Linear;

/// How far a model's forecasts were off on data that it was not trained on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ResidualStats {
    /// Standard deviation of reading minus forecast, in watt, not negative.
    pub std_w: f32,
    /// 5 % quantile of reading minus forecast, in watt.
    pub q05_w: f32,
    /// 95 % quantile of reading minus forecast, in watt, at least `q05_w`.
    pub q95_w: f32,
}

impl ResidualStats {
    /// Refuses values that are not finite or contradict one another.
    ///
    /// # Errors
    /// [`ModelError::Field`] names the value, what was found and what is allowed.
    pub fn check(&self) -> Result<(), ModelError> {
        let std_fine = self.std_w >= 0.0 && self.std_w.is_finite();
        if !std_fine {
            return Err(ModelError::field(
                "residual_std_w",
                &self.std_w,
                "finite and >= 0",
            ));
        }
        let ordered = self.q05_w.is_finite() && self.q95_w.is_finite() && self.q05_w <= self.q95_w;
        if !ordered {
            let found = format!("{} to {}", self.q05_w, self.q95_w);
            return Err(ModelError::field(
                "residual_q05_w to residual_q95_w",
                &found,
                "ascending",
            ));
        }
        Ok(())
    }
}

/// Smallest and largest value of each feature in the training data, in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainingRange {
    /// The features that the model reads; the entries of the others mean nothing.
    pub feature_set: FeatureSet,
    /// Smallest value of each feature.
    pub min: Features,
    /// Largest value of each feature.
    pub max: Features,
}

impl TrainingRange {
    /// The range of some rows, of the features that a model reads.
    #[must_use]
    pub fn of<'a>(feature_set: FeatureSet, rows: impl Iterator<Item = &'a Features>) -> Self {
        let mut range = Self {
            feature_set,
            min: Features::default(),
            max: Features::default(),
        };
        range.min[feature_set.range()].fill(f32::INFINITY);
        range.max[feature_set.range()].fill(f32::NEG_INFINITY);
        for row in rows {
            for feature in feature_set.range() {
                range.min[feature] = range.min[feature].min(row[feature]);
                range.max[feature] = range.max[feature].max(row[feature]);
            }
        }
        range
    }

    /// Position of the first feature that the model reads and that lies outside the range, or is
    /// NaN; `None` if all lie inside. `margin` widens each side by that share of the range's width.
    pub fn outside(&self, row: &Features, margin: f32) -> Option<usize> {
        self.feature_set.range().find(|&index| {
            let slack = margin * (self.max[index] - self.min[index]);
            let inside =
                self.min[index] - slack <= row[index] && row[index] <= self.max[index] + slack;
            !inside
        })
    }
}

/// Scores on held-out data, with persistence beside the network.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Scores {
    /// Number of forecasts scored.
    pub rows: u64,
    /// Coefficient of determination of the network.
    pub network_r2: f32,
    /// Mean absolute error of the network in watt.
    pub network_mae_w: f32,
    /// Coefficient of determination of persistence.
    pub persistence_r2: f32,
    /// Mean absolute error of persistence in watt.
    pub persistence_mae_w: f32,
}

/// Where a network comes from and how good it was.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelCard {
    /// Name for people.
    pub name: String,
    /// `simulation` or a description of the recordings.
    pub source: String,
    /// Description of the training data.
    pub training_data: String,
    /// SHA-256 of the training rows, hexadecimal.
    pub training_data_sha256: String,
    /// Seed of initial weights, batches and dropout.
    pub seed: u64,
    /// Range of the features in training.
    pub training_range: TrainingRange,
    /// Residuals on held-out data.
    pub residual: ResidualStats,
    /// Scores on held-out data.
    pub scores: Scores,
    /// The linear forecast fitted to the same rows, if there is one.
    pub linear: Option<Linear>,
}

impl ModelCard {
    /// A card that states the range and nothing else yet.
    #[must_use]
    pub fn new(training_range: TrainingRange) -> Self {
        Self {
            name: String::new(),
            source: String::new(),
            training_data: String::new(),
            training_data_sha256: String::new(),
            seed: 0,
            training_range,
            residual: ResidualStats::default(),
            scores: Scores::default(),
            linear: None,
        }
    }
}
