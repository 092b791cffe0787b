//! Training settings.

use joulebus_energy::Limit;
use joulebus_predictor::FeatureSet;
use serde::{Deserialize, Serialize};

use super::TrainError;
use super::adam::Hyperparameters;

/// Training settings: the hyperparameters of the paper's recipe (arXiv 2603.13908, section 5) and
/// of Adam.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrainSettings {
    /// Name of the model.
    pub name: String,
    /// Source of the data: `simulation`, or a description of the recordings.
    pub source: String,
    /// The features that the network reads: `full` (the paper's), `power-only`, and both with the
    /// age of the newest reading: `freshness`, `power-freshness`.
    #[serde(with = "FeatureSetName")]
    pub feature_set: FeatureSet,
    /// Seed of initial weights, order of rows and dropout.
    pub seed: u64,
    /// Dropout probability of hidden values, from 0 up to but not including 1. Quantised to
    /// 1/65,536.
    pub dropout: f64,
    /// Epochs without a lower validation loss after which training stops, at least 1.
    pub patience: u32,
    /// Maximum number of epochs, at least 1.
    pub max_epochs: u32,
    /// Rows per step, 1 to 65,536.
    pub batch: usize,
    /// Adam's learning rate, above 0 and up to 1.
    pub learning_rate: f64,
    /// Adam's β₁, from 0 up to but not including 1.
    pub first_moment: f64,
    /// Adam's β₂, from 0 up to but not including 1.
    pub second_moment: f64,
    /// Adam's ε, above 0 and up to 1.
    pub epsilon: f64,
    /// What the recordings cannot show and training cannot see: `measured_velocities` if the
    /// commands are measured velocities, `drive_power` if the power is that of the drives alone.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub limits: Vec<Limit>,
    /// Power that the robot draws beside what was recorded, W, at least 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hotel_w: Option<f32>,
}

impl Default for TrainSettings {
    /// The paper's recipe.
    fn default() -> Self {
        Self {
            name: "model".to_owned(),
            source: "recordings".to_owned(),
            feature_set: FeatureSet::Full,
            seed: 0,
            dropout: 0.1,
            patience: 10,
            max_epochs: 100,
            batch: 256,
            learning_rate: 1e-3,
            first_moment: 0.9,
            second_moment: 0.999,
            epsilon: 1e-8,
            limits: Vec::new(),
            hotel_w: None,
        }
    }
}

impl TrainSettings {
    /// The paper's recipe.
    pub fn new(name: &str, source: &str, feature_set: FeatureSet, seed: u64) -> TrainSettings {
        TrainSettings {
            name: name.to_owned(),
            source: source.to_owned(),
            feature_set,
            seed,
            ..Self::default()
        }
    }

    /// Checks every setting.
    ///
    /// # Errors
    /// [`TrainError::Setting`] names the first that is out of range.
    pub fn check(&self) -> Result<(), TrainError> {
        const SHARE: &str = "from 0 up to but not including 1";
        const SMALL: &str = "above 0 and up to 1";
        let share = |value: f64| (0.0..1.0).contains(&value);
        let small = |value: f64| value > 0.0 && value <= 1.0;
        let Self {
            dropout,
            patience,
            max_epochs,
            batch,
            learning_rate,
            first_moment,
            second_moment,
            epsilon,
            ..
        } = *self;
        let hotel_w = f64::from(self.hotel_w.unwrap_or(0.0));
        let (rows, [epochs, waited]) = (batch as f64, [max_epochs, patience].map(f64::from));
        let checks = [
            ("dropout", dropout, share(dropout), SHARE),
            ("patience", waited, patience > 0, "at least 1"),
            ("max_epochs", epochs, max_epochs > 0, "at least 1"),
            ("batch", rows, (1..=65_536).contains(&batch), "1 to 65536"),
            ("learning_rate", learning_rate, small(learning_rate), SMALL),
            ("first_moment", first_moment, share(first_moment), SHARE),
            ("second_moment", second_moment, share(second_moment), SHARE),
            ("epsilon", epsilon, small(epsilon), SMALL),
            ("hotel_w", hotel_w, (0.0..=1e6).contains(&hotel_w), "0 to 1000000"),
        ];
        match checks.into_iter().find(|(_, _, sound, _)| !sound) {
            None => Ok(()),
            Some((setting, found, _, allowed)) => {
                Err(TrainError::Setting { setting, found, allowed })
            }
        }
    }

    pub(super) fn hyperparameters(&self) -> Hyperparameters {
        Hyperparameters {
            learning_rate: self.learning_rate,
            first_moment: self.first_moment,
            second_moment: self.second_moment,
            epsilon: self.epsilon,
        }
    }
}

/// The recipe of the shipped models: the paper's, under their name.
pub fn settings_for_sim(seed: u64, feature_set: FeatureSet) -> TrainSettings {
    let name = match feature_set {
        FeatureSet::Full => "gternal-sim",
        FeatureSet::PowerOnly => "gternal-sim-power",
        FeatureSet::Freshness => "gternal-sim-freshness",
        FeatureSet::PowerFreshness => "gternal-sim-power-freshness",
    };
    TrainSettings::new(name, "simulation", feature_set, seed)
}

/// The names of [`FeatureSet`] in settings.
#[derive(Serialize, Deserialize)]
#[serde(remote = "FeatureSet", rename_all = "kebab-case")]
enum FeatureSetName {
    Full,
    PowerOnly,
    Freshness,
    PowerFreshness,
}
