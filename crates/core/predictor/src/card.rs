//! Model card: origin and scores of a network.

use joulebus_energy::EnergyModel;

use crate::error::ModelError;
use crate::features::{FeatureSet, Features};
use crate::linear::Linear;

/// Residuals of a model on held-out data.
///
/// ```
/// use joulebus_predictor::ResidualStats;
///
/// let residual = ResidualStats { std_w: 0.1, q05_w: -0.2, q95_w: 0.2 };
/// assert!(residual.check().is_ok());
/// for std_w in [f32::NAN, -0.1, 3e38] {
///     assert!(ResidualStats { std_w, ..residual }.check().is_err());
/// }
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ResidualStats {
    /// Standard deviation of reading minus forecast, W, not negative.
    pub std_w: f32,
    /// 5 % quantile of reading minus forecast, W.
    pub q05_w: f32,
    /// 95 % quantile of reading minus forecast, W, at least `q05_w`.
    pub q95_w: f32,
}

/// Largest residual, W: powers of robots are below it.
const MAX_RESIDUAL_W: f32 = 1e6;

impl ResidualStats {
    /// Refuses values that no robot has, and inconsistent ones.
    ///
    /// # Errors
    /// [`ModelError::Field`] with the value, the found and the allowed one.
    pub fn check(&self) -> Result<(), ModelError> {
        if !(0.0..=MAX_RESIDUAL_W).contains(&self.std_w) {
            return Err(ModelError::field("residual_std_w", &self.std_w, "0 to 1e6"));
        }
        let range = -MAX_RESIDUAL_W..=MAX_RESIDUAL_W;
        let ends = [self.q05_w, self.q95_w];
        if !(ends.iter().all(|end| range.contains(end)) && self.q05_w <= self.q95_w) {
            let (found, allowed) =
                (format!("{} to {}", ends[0], ends[1]), "ascending, -1e6 to 1e6");
            return Err(ModelError::field("residual_q05_w to residual_q95_w", &found, allowed));
        }
        Ok(())
    }
}

/// Minimum and maximum of each feature in the training data, in SI units.
///
/// ```
/// use joulebus_predictor::{FeatureSet, INPUTS, TrainingRange};
///
/// let rows = [[1.0; INPUTS], [3.0; INPUTS]];
/// let range = TrainingRange::of(FeatureSet::PowerOnly, rows.iter());
/// assert_eq!(range.outside(&[2.0; INPUTS], 0.0), None);
/// assert!(range.outside(&[4.0; INPUTS], 0.1).is_some());
/// assert_eq!(range.fed_back_w(9.0), 3.0);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainingRange {
    /// The features that the model reads. The entries of the others are meaningless.
    pub feature_set: FeatureSet,
    /// Minimum of each feature.
    pub min: Features,
    /// Maximum of each feature.
    pub max: Features,
}

impl TrainingRange {
    /// The value that a rollout feeds back for a forecast, W: the nearest power that the training
    /// data had as newest reading. The network is not trained on others, and its errors there would
    /// amplify. NaN stays NaN.
    #[inline(always)]
    #[must_use]
    pub fn fed_back_w(&self, forecast_w: f32) -> f32 {
        const NEWEST: usize = FeatureSet::PowerOnly.first();
        let (min_w, max_w) = (self.min[NEWEST], self.max[NEWEST]);
        let above = if forecast_w < min_w { min_w } else { forecast_w };
        if above > max_w { max_w } else { above }
    }

    /// The range of the features read, over some rows.
    #[must_use]
    pub fn of<'a>(feature_set: FeatureSet, rows: impl Iterator<Item = &'a Features>) -> Self {
        let mut range = Self { feature_set, min: Features::default(), max: Features::default() };
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

    /// Index of the first feature read that is outside the range, or is NaN. `None` if all are
    /// inside. `margin` widens each side by that share of the range's width.
    pub fn outside(&self, row: &Features, margin: f32) -> Option<usize> {
        self.feature_set.range().find(|&index| {
            let slack = margin * (self.max[index] - self.min[index]);
            let inside =
                self.min[index] - slack <= row[index] && row[index] <= self.max[index] + slack;
            !inside
        })
    }
}

/// Scores on held-out data, of the network and of persistence.
///
/// [`ModelCard`] has an example.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Scores {
    /// Number of forecasts scored.
    pub rows: u64,
    /// Coefficient of determination of the network.
    pub network_r2: f32,
    /// Mean absolute error of the network, W.
    pub network_mae_w: f32,
    /// Coefficient of determination of persistence.
    pub persistence_r2: f32,
    /// Mean absolute error of persistence, W.
    pub persistence_mae_w: f32,
}

/// [`ModelCard::source`] of models that were trained on simulated robots.
pub const SIMULATED: &str = "simulation";
/// Time between two steps of the Robotarium, s, whose robots are simulated.
const ROBOTARIUM_STEP_S: f32 = 0.033;

/// Identifies the rows that a network was trained on: hashes of blocks of consecutive readings,
/// computed and compared by `joulebus_dataset::trained_rows`.
///
/// ```
/// # use joulebus_predictor::ModelCard;
/// # fn example(card: &ModelCard) {
/// match &card.trained_rows {
///     Some(trained) => {
///         let hashes: usize = trained.blocks.iter().map(|blocks| blocks.hashes.len()).sum();
///         println!("{} rows, recognised by {hashes} hashes", trained.rows);
///     }
///     None => println!("no recording can be recognised"),
/// }
/// # }
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TrainedRows {
    /// Rows that weights were fitted to or that chose among them, in early stopping.
    pub rows: u64,
    /// Blocks of equal numbers of rows.
    pub blocks: Vec<TrainedBlocks>,
}

/// Hashes of blocks of the same number of rows.
///
/// [`TrainedRows`] has an example.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TrainedBlocks {
    /// Rows of each, at least 1.
    pub rows: u32,
    /// One hash for each, ascending.
    pub hashes: Vec<u64>,
}

/// Origin and scores of a network.
///
/// ```
/// use joulebus_predictor::{FeatureSet, INPUTS, ModelCard, Scores, TrainingRange};
///
/// let rows = [[1.0; INPUTS], [3.0; INPUTS]];
/// let card = ModelCard {
///     name: "courier".to_owned(),
///     step_s: Some(0.1),
///     scores: Scores { network_mae_w: 0.2, persistence_mae_w: 0.5, ..Scores::default() },
///     ..ModelCard::new(TrainingRange::of(FeatureSet::PowerOnly, rows.iter()))
/// };
/// assert_eq!(card.period_s(), Some(0.1));
/// assert!(card.scores.network_mae_w < card.scores.persistence_mae_w);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct ModelCard {
    /// Display name.
    pub name: String,
    /// `simulation` or a description of the recordings.
    pub source: String,
    /// Description of the training data.
    pub training_data: String,
    /// SHA-256 of the training rows, hexadecimal.
    pub training_data_sha256: String,
    /// The training rows, to be recognised. `None` if unknown: imported models and older files.
    pub trained_rows: Option<TrainedRows>,
    /// Seed of initial weights, batches and dropout.
    pub seed: u64,
    /// Time between two readings of the training data, s. `None` if unknown: imported models,
    /// simulated ones, and older files.
    pub step_s: Option<f32>,
    /// Training range of the features.
    pub training_range: TrainingRange,
    /// Residuals on held-out data.
    pub residual: ResidualStats,
    /// Scores on held-out data.
    pub scores: Scores,
    /// The linear baseline fitted to the same rows, if there is one.
    pub linear: Option<Linear>,
    /// The energy of longer plans, fitted to the same recordings. `None` for imported models and
    /// older files.
    pub energy: Option<EnergyModel>,
}

impl ModelCard {
    /// A card with only the training range set.
    #[must_use]
    pub fn new(training_range: TrainingRange) -> Self {
        Self {
            name: String::new(),
            source: String::new(),
            training_data: String::new(),
            training_data_sha256: String::new(),
            trained_rows: None,
            seed: 0,
            step_s: None,
            training_range,
            residual: ResidualStats::default(),
            scores: Scores::default(),
            linear: None,
            energy: None,
        }
    }
    /// Time between two steps at which the network forecasts, s: as stated, or that of the
    /// Robotarium for its simulated robots.
    pub fn period_s(&self) -> Option<f32> {
        let simulated = (self.source == SIMULATED).then_some(ROBOTARIUM_STEP_S);
        self.step_s.or(simulated)
    }
}
