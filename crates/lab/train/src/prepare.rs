//! Preparation of training rows: filtering and normalisation.

use std::borrow::Cow;

use joulebus_predictor::training::TrainedRows;
use joulebus_predictor::{FEATURE_NAMES, FeatureSet, INPUTS, Normalisation};
use serde::Serialize;

use joulebus_dataset::rows::{Dataset, Row};
use joulebus_dataset::trained_rows::is_trained_on;

use super::TrainError;
use super::chunk::{Example, PADDED_INPUTS};

/// Irregularities of the data that were worked around.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Findings {
    /// Rows left out because an input or target is NaN or infinite: training, validation, held out.
    pub unusable_rows: [usize; 3],
    /// Held-out rows that were also trained on, as in a copy of a recording. They are not scored.
    pub held_out_trained_on: usize,
    /// Features that are constant in the training rows: the network gets 0 for them.
    pub constant_features: Vec<&'static str>,
    /// Number of training rows.
    pub training_rows: usize,
    /// True if there are fewer training rows than weights, with a risk of overfitting.
    pub few_rows: bool,
    /// Number of recordings that show the errors of the energy of plans.
    pub recordings: usize,
    /// True if they are too few: plans then have no interval.
    pub few_recordings: bool,
}

/// The usable rows.
pub(super) fn usable(dataset: &Dataset, feature_set: FeatureSet) -> (Dataset, [usize; 3]) {
    let finite = |row: &&Row| {
        let read = row.features[feature_set.range()].iter();
        read.chain([&row.target_w]).all(|value| value.is_finite())
    };
    let keep = |rows: &[Row]| -> Vec<Row> { rows.iter().filter(finite).copied().collect() };
    let kept = Dataset {
        training: keep(&dataset.training),
        validation: keep(&dataset.validation),
        held_out: keep(&dataset.held_out),
        description: dataset.description.clone(),
        period_s: dataset.period_s,
    };
    let unusable = [
        dataset.training.len() - kept.training.len(),
        dataset.validation.len() - kept.validation.len(),
        dataset.held_out.len() - kept.held_out.len(),
    ];
    (kept, unusable)
}

/// The dataset without held-out rows that were also trained on, and their number. Its description
/// states their share.
pub(super) fn without_known<'a>(
    dataset: &'a Dataset,
    trained_rows: Option<&TrainedRows>,
) -> (Cow<'a, Dataset>, usize) {
    let is_known = trained_rows.map(|trained| is_trained_on(&dataset.held_out, trained));
    let is_known = is_known.unwrap_or_default();
    let known = is_known.iter().filter(|known| **known).count();
    if known == 0 {
        return (Cow::Borrowed(dataset), 0);
    }
    let mut dataset = dataset.clone();
    let of = dataset.held_out.len();
    let mut is_known = is_known.into_iter();
    dataset.held_out.retain(|_| is_known.next() == Some(false));
    let percent = 100.0 * known as f64 / of as f64;
    let share = format!("{known} of {of} held-out rows ({percent:.1} %)");
    dataset.description =
        format!("{}; {share} were also trained on and are not scored", dataset.description);
    (Cow::Owned(dataset), known)
}

/// Names of the constant features.
pub(super) fn constant_features(
    normalisation: &Normalisation,
    feature_set: FeatureSet,
) -> Vec<&'static str> {
    feature_set
        .range()
        .filter(|i| normalisation.feature_std[*i] == 0.0)
        .map(|i| FEATURE_NAMES[i])
        .collect()
}

impl Example {
    pub(super) fn new(row: &Row, normalisation: &Normalisation, feature_set: FeatureSet) -> Self {
        let Normalisation { feature_mean, feature_std, power_mean_w, power_std_w } = normalisation;
        let scaled = |value: f32, mean: f32, std: f32| {
            if std > 0.0 {
                ((f64::from(value) - f64::from(mean)) / f64::from(std)) as f32
            } else {
                0.0
            }
        };
        let mut inputs = [0.0; PADDED_INPUTS];
        for (input, i) in inputs.iter_mut().zip(feature_set.range()) {
            *input = scaled(row.features[i], feature_mean[i], feature_std[i]);
        }
        Self { inputs, target: scaled(row.target_w, *power_mean_w, *power_std_w) }
    }
}

pub(super) fn normalisation(
    rows: &[Row],
    feature_set: FeatureSet,
) -> Result<Normalisation, TrainError> {
    let mut feature_mean = [0.0; INPUTS];
    let mut feature_std = [0.0; INPUTS];
    for i in feature_set.range() {
        (feature_mean[i], feature_std[i]) = mean_and_std(rows.iter().map(|row| row.features[i]));
    }
    let (power_mean_w, power_std_w) = mean_and_std(rows.iter().map(|row| row.target_w));
    if power_std_w > 0.0 {
        Ok(Normalisation { feature_mean, feature_std, power_mean_w, power_std_w })
    } else {
        Err(TrainError::ConstantPower { rows: rows.len(), power_w: power_mean_w })
    }
}

/// Two passes. The deviation of equal values is exactly 0.
pub(super) fn mean_and_std(values: impl Iterator<Item = f32> + Clone) -> (f32, f32) {
    let count = values.clone().count() as f64;
    let mean = values.clone().map(f64::from).sum::<f64>() / count;
    let first = values.clone().next();
    if values.clone().all(|value| Some(value) == first) {
        return (mean as f32, 0.0);
    }
    let squares = values.map(|value| (f64::from(value) - mean) * (f64::from(value) - mean));
    (mean as f32, libm::sqrt(squares.sum::<f64>() / count) as f32)
}
