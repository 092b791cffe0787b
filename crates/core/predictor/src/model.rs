//! A model as used by the tick: a network or a baseline.

use std::ops::Range;

use joulebus_energy::EnergyModel;

use crate::card::{ResidualStats, TrainingRange};
use crate::error::{LengthError, RolloutError};
use crate::features::{FEATURE_NAMES, FeatureSet, Features, INPUTS};
use crate::kernel::SimdLevel;
use crate::linear::Linear;
use crate::nan::canonical;
use crate::network::Network;
use crate::persistence::Persistence;
use crate::rollout::Rollouts;

/// The forecaster of one platform.
///
/// ```
/// use joulebus_predictor::{Model, Persistence, ResidualStats, features};
///
/// let residual = ResidualStats { std_w: 0.1, q05_w: -0.2, q95_w: 0.2 };
/// let model = Model::Persistence(Persistence::new(residual)?);
/// // A row for each robot: one drives at 0.2 m/s, one stands. The newest reading comes first.
/// let driving = features(0.2, 0.0, None, &[4.2, 4.0, 4.0, 4.0, 4.0]);
/// let standing = features(0.0, 0.0, None, &[1.5, 1.5, 1.6, 1.5, 1.5]);
/// let mut forecasts_w = [0.0; 2];
/// model.predict(&[driving, standing], &mut forecasts_w);
/// assert_eq!(forecasts_w, [4.2, 1.5]);
/// # Ok::<(), joulebus_predictor::ModelError>(())
/// ```
#[derive(Clone, Debug)]
pub enum Model {
    /// A trained network.
    Network(Network),
    /// Repeats the last reading.
    Persistence(Persistence),
}

impl Model {
    /// The features read.
    pub fn feature_set(&self) -> FeatureSet {
        match self {
            Model::Network(network) => network.feature_set(),
            Model::Persistence(_) => FeatureSet::PowerOnly,
        }
    }

    /// True if forecasts need velocities. Without them, such a model forecasts NaN, never a number
    /// computed from zeros.
    pub fn needs_command(&self) -> bool {
        self.feature_set().needs_command()
    }

    /// True if forecasts need the age of the newest reading. Without it, such a model forecasts
    /// NaN.
    pub fn needs_freshness(&self) -> bool {
        self.feature_set().needs_freshness()
    }

    /// Forecasts one reading in watt for each row. Allocates nothing. A row with a NaN or an
    /// infinity among the features read gives a forecast that is not finite, and changes no other
    /// row.
    ///
    /// **Lengths** should be equal. As with [`Iterator::zip`], rows beyond the shorter slice are
    /// not computed, and forecasts beyond it keep what they had.
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

    /// Same as [`Model::predict`], with one column for each feature, in the order of [`Features`]:
    /// `features[f][i]` is feature `f` of row `i`. The same bits.
    ///
    /// Columns of features that the model does not read ([`Model::feature_set`]) may be empty.
    ///
    /// ```
    /// # use joulebus_predictor::{INPUTS, LengthError, Model, Persistence, ResidualStats};
    /// # let model = Model::Persistence(Persistence::new(ResidualStats::default())?);
    /// // Readings of two robots, W.
    /// let mut columns: [&[f32]; INPUTS] = [&[]; INPUTS];
    /// for lag in model.feature_set().range() {
    ///     columns[lag] = &[4.2, 1.5];
    /// }
    /// let mut forecasts_w = [0.0; 2];
    /// model.predict_columns(columns, &mut forecasts_w)?;
    /// assert_eq!(forecasts_w, [4.2, 1.5]);
    /// let refused = model.predict_columns(columns, &mut [0.0; 3]);
    /// assert_eq!(refused, Err(LengthError { column: "power_lag1_w", found: 2, allowed: 3 }));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`LengthError`] where a column that is read, or is not empty, has another length than
    /// `forecasts_w`. Nothing is written then.
    pub fn predict_columns(
        &self,
        features: [&[f32]; INPUTS],
        forecasts_w: &mut [f32],
    ) -> Result<(), LengthError> {
        let count = forecasts_w.len();
        let read = self.feature_set().range();
        for (feature, column) in features.iter().enumerate() {
            let is_unread = column.is_empty() && !read.contains(&feature);
            if column.len() != count && !is_unread {
                return Err(LengthError {
                    column: FEATURE_NAMES[feature],
                    found: column.len(),
                    allowed: count,
                });
            }
        }
        match self {
            Model::Network(network) => network.predict_columns(&features, forecasts_w),
            Model::Persistence(_) => forecasts_w.copy_from_slice(features[read.start]),
        }
        Ok(())
    }

    /// The instruction set for other loops, which is the network kernel's.
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

    /// Display name.
    pub fn name(&self) -> &str {
        match self {
            Model::Network(network) => &network.card().name,
            Model::Persistence(_) => "persistence",
        }
    }

    /// Residuals on held-out data.
    pub fn residual(&self) -> ResidualStats {
        match self {
            Model::Network(network) => network.card().residual,
            Model::Persistence(persistence) => persistence.residual,
        }
    }

    /// Training range of the features. `None` for a model without training.
    pub fn training_range(&self) -> Option<&TrainingRange> {
        match self {
            Model::Network(network) => Some(&network.card().training_range),
            Model::Persistence(_) => None,
        }
    }

    /// The linear baseline fitted to the same rows, if there is one.
    pub fn linear(&self) -> Option<&Linear> {
        match self {
            Model::Network(network) => network.card().linear.as_ref(),
            Model::Persistence(_) => None,
        }
    }

    /// The energy of longer plans. `None` for a model without training, an imported one, and a file
    /// of an older version.
    pub fn energy(&self) -> Option<&EnergyModel> {
        match self {
            Model::Network(network) => network.card().energy.as_ref(),
            Model::Persistence(_) => None,
        }
    }

    /// [`Model::energy`], and without one the mean of the last seconds without intervals. A robot
    /// that has not been read is then assumed to draw `power_max_w`, the most that its platform
    /// can, W.
    pub fn energy_or_untrained(&self, power_max_w: f32) -> EnergyModel {
        let untrained = || EnergyModel::untrained(power_max_w.max(f32::MIN_POSITIVE));
        self.energy().cloned().unwrap_or_else(untrained)
    }

    /// Rolls out the candidates of `lanes` and writes the energy of each in joule, and optionally
    /// its forecast of every step in watt (step by step: `power_w[t * lanes.len() + l]`).
    ///
    /// At each step the features are the command of that step, the derivatives over `step_s`, and
    /// as lag window the model's own forecasts as [fed back](TrainingRange::fed_back_w), preceded
    /// by the robot's readings. The bits are those of [`Model::predict`] called step by step with
    /// rows of [`features`](crate::features()). The energy is `step_s` times the sum of the
    /// forecasts in step order, both in double precision, rounded once. A lane with a command or
    /// reading that is not finite gives results that are not finite from that step on, and changes
    /// no other lane.
    ///
    /// `lanes` is a part of `0..rollouts.lanes()`, so that threads can share the work: the outputs
    /// are those of the part only. Allocates nothing.
    ///
    /// # Errors
    /// [`RolloutError`] where the time step is not positive and finite, lanes are out of range, or
    /// the length of a slice does not match the shape. Nothing is written then.
    pub fn rollout(
        &self,
        rollouts: &Rollouts<'_>,
        lanes: Range<usize>,
        energy_j: &mut [f32],
        power_w: Option<&mut [f32]>,
    ) -> Result<(), RolloutError> {
        rollouts.check(&lanes, energy_j.len(), power_w.as_deref().map(<[f32]>::len))?;
        match self {
            Model::Network(network) => {
                network.rollout(rollouts, lanes.start, energy_j, power_w);
            }
            Model::Persistence(_) => repeat(rollouts, lanes, energy_j, power_w),
        }
        Ok(())
    }
}

/// Persistence in open loop: the newest reading at every step.
fn repeat(
    rollouts: &Rollouts<'_>,
    lanes: Range<usize>,
    energy_j: &mut [f32],
    mut power_w: Option<&mut [f32]>,
) {
    let count = lanes.len();
    for (index, lane) in lanes.enumerate() {
        let [newest_w, ..] = rollouts.starts[lane / rollouts.candidates].lag_w;
        let mut sum_w = 0.0f64;
        for step in 0..rollouts.steps {
            sum_w += f64::from(newest_w);
            if let Some(power_w) = power_w.as_deref_mut() {
                power_w[step * count + index] = newest_w;
            }
        }
        energy_j[index] = canonical((sum_w * f64::from(rollouts.step_s)) as f32);
    }
}
