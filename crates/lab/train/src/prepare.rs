//! Preparation of training rows: filtering and normalisation.

use std::borrow::Cow;

use joulebus_predictor::training::TrainedRows;
use joulebus_predictor::{FEATURE_NAMES, FeatureSet, INPUTS, Normalisation};
use serde::Serialize;

use joulebus_dataset::rows::{Dataset, Row};
use joulebus_dataset::trained_rows::{hashed, is_trained_on, is_untold, runs};

use super::TrainError;
use super::chunk::{Example, PADDED_INPUTS};

/// Share of a held-out recording's rows from which it counts as a copy of training data. Rows of
/// which nothing can be known do not count.
const COPIED: f64 = 0.25;

/// Irregularities of the data that were worked around.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Findings {
    /// Rows left out because an input or target is NaN or infinite: training, validation, held out.
    pub unusable_rows: [usize; 3],
    /// Held-out rows that were also trained on, and the others of recordings of which at least a
    /// quarter was. They are not scored.
    pub held_out_trained_on: usize,
    /// Scored rows in pieces too short, or that change too rarely, to be recognised if they were
    /// also trained on.
    pub held_out_untold: usize,
    /// Rows for early stopping that are also among those for fitting.
    pub validation_trained_on: usize,
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

/// The features that these recordings have: velocities and readings, or readings alone if fewer
/// than half of the training rows have velocities.
#[must_use]
pub fn recorded_features(dataset: &Dataset) -> FeatureSet {
    let velocities = FeatureSet::Full.range().start..FeatureSet::PowerOnly.first();
    let has_velocities =
        |row: &&Row| row.features[velocities.clone()].iter().all(|value| value.is_finite());
    let with = dataset.training.iter().filter(has_velocities).count();
    match 2 * with < dataset.training.len() {
        true => FeatureSet::PowerOnly,
        false => FeatureSet::Full,
    }
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

/// Rows of a part that are also in another part.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Known {
    pub(super) held_out: usize,
    pub(super) held_out_untold: usize,
    pub(super) validation: usize,
}

/// The dataset without held-out rows that were also trained on. Its description states the share
/// of known rows.
pub(super) fn without_known<'a>(
    dataset: &'a Dataset,
    trained_rows: Option<&TrainedRows>,
) -> (Cow<'a, Dataset>, Known) {
    let (is_known, held_out_untold) = held_out_known(dataset, trained_rows);
    let count = |mask: &[bool]| mask.iter().filter(|known| **known).count();
    let known = Known {
        held_out: count(&is_known),
        held_out_untold,
        validation: count(&validation_known(dataset)),
    };
    if known.held_out == 0 && known.validation == 0 {
        return (Cow::Borrowed(dataset), known);
    }
    let mut dataset = dataset.clone();
    let share = |known: usize, of: usize, part: &str| {
        let percent = 100.0 * known as f64 / of as f64;
        format!("; {known} of {of} {part} rows ({percent:.1} %)")
    };
    if known.validation > 0 {
        let share = share(known.validation, dataset.validation.len(), "validation");
        dataset.description +=
            &format!("{share} were also trained on, so it may have stopped late");
    }
    if known.held_out > 0 {
        let share = share(known.held_out, dataset.held_out.len(), "held-out");
        dataset.description += &format!("{share} were also trained on and are not scored");
    }
    let mut is_known = is_known.into_iter();
    dataset.held_out.retain(|_| is_known.next() == Some(false));
    (Cow::Owned(dataset), known)
}

/// Which held-out rows are trained on, and of how many that is unknown. Short pieces of a copy are
/// not recognised, so all rows of its recording count if a good part is. So they do if a good part
/// has the shape of training rows.
fn held_out_known(dataset: &Dataset, trained_rows: Option<&TrainedRows>) -> (Vec<bool>, usize) {
    let rows = &dataset.held_out;
    let Some(trained) = trained_rows else {
        return (vec![false; rows.len()], rows.len());
    };
    let mut is_known = is_trained_on(rows, trained);
    let is_untold = is_untold(rows, &is_known, trained);
    let mut untold = 0;
    let mut end = 0;
    for recording in recordings(rows, dataset.period_s > 0.0) {
        let start = end;
        end += recording.len();
        let of = |mask: &[bool]| mask[start..end].iter().filter(|is| **is).count();
        let (known, of_untold) = (of(&is_known), of(&is_untold));
        let is_copy = known > 0 && known as f64 >= COPIED * (recording.len() - of_untold) as f64;
        if is_copy {
            is_known[start..end].fill(true);
        } else {
            untold += of_untold;
        }
    }
    (is_known, untold)
}

/// Which rows for early stopping are among those for fitting.
fn validation_known(dataset: &Dataset) -> Vec<bool> {
    let fitted = hashed([&dataset.training]);
    fitted.map(|fitted| is_trained_on(&dataset.validation, &fitted)).unwrap_or_default()
}

/// The rows by recording. If the recordings are not known, each gapless run counts as one.
fn recordings(rows: &[Row], is_recording_known: bool) -> Vec<&[Row]> {
    match is_recording_known {
        true => rows.chunk_by(|a, b| a.origin.recording == b.origin.recording).collect(),
        false => runs(rows).collect(),
    }
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
