//! A model as the tick sees it: the network or a baseline.

use crate::{FEATURE_NAMES, FeatureSet, Features, INPUTS, Linear, ModelError, Network, SimdLevel};
use sha2::{Digest, Sha256};

/// How far a model's forecasts were off on data that it was not trained on.
#[derive(Clone, Copy, Debug, PartialEq)]
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

/// The baseline that repeats the last reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Persistence {
    residual: ResidualStats,
    hash: u64,
}

impl Persistence {
    /// Persistence with the residuals that it has on the platform's data; they set the width of
    /// the first intervals. Refuses residuals that are not finite or contradict one another.
    pub fn new(residual: ResidualStats) -> Result<Persistence, ModelError> {
        residual.check()?;
        let mut digest = Sha256::new();
        digest.update(b"persistence");
        for value in [residual.std_w, residual.q05_w, residual.q95_w] {
            digest.update(value.to_le_bytes());
        }
        Ok(Persistence {
            residual,
            hash: leading_u64(&digest.finalize()),
        })
    }
}

pub(crate) fn leading_u64(digest: &[u8]) -> u64 {
    digest
        .iter()
        .take(8)
        .fold(0, |hash, &byte| hash << 8 | u64::from(byte))
}

/// What forecasts the power of the robots of one platform.
#[derive(Clone, Debug)]
pub enum Model {
    /// A trained network.
    Network(Network),
    /// The last reading again.
    Persistence(Persistence),
}

impl Model {
    /// The features that are read.
    pub fn feature_set(&self) -> FeatureSet {
        match self {
            Model::Network(network) => network.feature_set(),
            Model::Persistence(_) => FeatureSet::PowerOnly,
        }
    }

    /// Whether forecasts need velocities. Without them, a model for which this is `true` forecasts
    /// NaN, never a number made up from zeros.
    pub fn needs_command(&self) -> bool {
        self.feature_set().needs_command()
    }

    /// Whether forecasts need to know how fresh the newest reading is. Without it, a model for which
    /// this is `true` forecasts NaN.
    pub fn needs_freshness(&self) -> bool {
        self.feature_set().needs_freshness()
    }

    /// Forecasts one reading in watt for each row. Rows past the shorter of the two slices are left
    /// alone; callers keep both the same length. Allocates nothing. A row with a NaN or an
    /// infinity among the features that the model reads gives a forecast that is not finite, and
    /// changes no other row.
    pub fn predict(&self, inputs: &[Features], out_w: &mut [f32]) {
        match self {
            Model::Network(network) => network.predict(inputs, out_w),
            Model::Persistence(_) => {
                for (row, forecast_w) in inputs.iter().zip(out_w) {
                    *forecast_w = row[FeatureSet::PowerOnly.first()];
                }
            }
        }
    }

    /// As [`Model::predict`], with one column for each feature, in the order of [`Features`]:
    /// `features[f][i]` is feature `f` of row `i`. The same bits.
    ///
    /// Columns of features that the model does not read ([`Model::feature_set`]) may be empty.
    ///
    /// # Panics
    /// If a column that is read, or is not empty, has another length than `forecasts_w`.
    pub fn predict_columns(&self, features: [&[f32]; INPUTS], forecasts_w: &mut [f32]) {
        let count = forecasts_w.len();
        let read = self.feature_set().range();
        for (feature, column) in features.iter().enumerate() {
            assert!(
                column.len() == count || (column.is_empty() && !read.contains(&feature)),
                "column {} has {} values, allowed: {count}, as many as forecasts_w",
                FEATURE_NAMES[feature],
                column.len(),
            );
        }
        match self {
            Model::Network(network) => network.predict_columns(&features, forecasts_w),
            Model::Persistence(_) => forecasts_w.copy_from_slice(features[read.start]),
        }
    }

    /// What the model runs on, for other work: a network's is that of its kernel.
    pub fn simd_level(&self) -> SimdLevel {
        match self {
            Model::Network(network) => network.simd_level(),
            Model::Persistence(_) => SimdLevel::best(),
        }
    }

    /// Identifies the model: equal for equal contents, on every machine.
    pub fn hash(&self) -> u64 {
        match self {
            Model::Network(network) => network.hash(),
            Model::Persistence(persistence) => persistence.hash,
        }
    }

    /// Name for people.
    pub fn name(&self) -> &str {
        match self {
            Model::Network(network) => &network.card().name,
            Model::Persistence(_) => "persistence",
        }
    }

    /// Residuals on data that the model was not trained on.
    pub fn residual(&self) -> ResidualStats {
        match self {
            Model::Network(network) => network.card().residual,
            Model::Persistence(persistence) => persistence.residual,
        }
    }

    /// Range of the features in training; `None` for a model that was not trained.
    pub fn training_range(&self) -> Option<&TrainingRange> {
        match self {
            Model::Network(network) => Some(&network.card().training_range),
            Model::Persistence(_) => None,
        }
    }

    /// The linear forecast that was fitted to the same rows; `None` where the file has none.
    pub fn linear(&self) -> Option<&Linear> {
        match self {
            Model::Network(network) => network.card().linear.as_ref(),
            Model::Persistence(_) => None,
        }
    }
}
