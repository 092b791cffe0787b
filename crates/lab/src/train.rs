//! A minimal trainer for the network, the same bytes from the same seed on every machine.
//!
//! The recipe is the paper's: Adam at 1e-3, batches of 256, dropout 0.1, GELU, mean squared error of
//! the normalised power, early stopping after ten epochs without progress. Everything is computed in
//! double precision by plain loops in a fixed order, with the portable functions of `libm` and
//! without fused multiply-adds; only the finished weights are rounded to f32.

mod gradients;
mod simulated;

pub use simulated::{SimulatedData, dataset_from_plant, train_sim};

use crate::noise::Noise;
use gradients::{Weights, Workspace};
use joulebus_predictor::{
    Card, FEATURES, FeatureSet, Features, ModelError, Network, Normalisation, Parameters,
    ResidualStats, Scores, TrainingRange,
};
use sha2::{Digest, Sha256};
use thiserror::Error;

const LEARNING_RATE: f64 = 1e-3;
const BATCH: usize = 256;
const FIRST_MOMENT: f64 = 0.9;
const SECOND_MOMENT: f64 = 0.999;
const ADAM_EPSILON: f64 = 1e-8;

/// One forecast to learn from: what is known, and the reading that followed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// Raw features in SI units; those that the feature set leaves out may be NaN.
    pub features: Features,
    /// The next reading in watt.
    pub target_w: f32,
}

/// Rows split by robot or trial, never by row: neighbouring rows know each other's answers.
#[derive(Clone, Debug, PartialEq)]
pub struct Dataset {
    /// Rows that decide the weights and the normalisation.
    pub training: Vec<Row>,
    /// Rows that decide when to stop.
    pub validation: Vec<Row>,
    /// Rows that decide nothing and give scores and residuals.
    pub held_out: Vec<Row>,
    /// Where the rows come from, for the model file.
    pub description: String,
}

impl Dataset {
    /// SHA-256 of all rows, hexadecimal: each part with its length before it, numbers little-endian.
    pub fn sha256(&self) -> String {
        let mut digest = Sha256::new();
        for rows in [&self.training, &self.validation, &self.held_out] {
            digest.update((rows.len() as u64).to_le_bytes());
            for row in rows {
                for value in row.features.iter().chain([&row.target_w]) {
                    digest.update(value.to_le_bytes());
                }
            }
        }
        digest
            .finalize()
            .iter()
            .map(|byte| format!("{byte:02x}"))
            .collect()
    }
}

/// How to train.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Name of the model.
    pub name: String,
    /// Source of the data: `simulation`, or a description of the recordings.
    pub source: String,
    /// The features that the network reads.
    pub feature_set: FeatureSet,
    /// Seed of initial weights, order of rows and dropout.
    pub seed: u64,
    /// Share of hidden values that are dropped in training, from 0 up to but not including 1.
    pub dropout: f64,
    /// Epochs without a better validation loss after which training ends.
    pub patience: u32,
    /// Epochs after which training ends at the latest, at least 1.
    pub max_epochs: u32,
}

impl Settings {
    /// The paper's recipe.
    pub fn new(name: &str, source: &str, feature_set: FeatureSet, seed: u64) -> Settings {
        Settings {
            name: name.to_owned(),
            source: source.to_owned(),
            feature_set,
            seed,
            dropout: 0.1,
            patience: 10,
            max_epochs: 100,
        }
    }
}

/// What an epoch came to. Losses are mean squared errors in units of the training variance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Epoch {
    /// Counts from 1.
    pub number: u32,
    /// Loss over the training rows, with dropout and with the weights as they changed.
    pub training_loss: f64,
    /// Loss over the validation rows at the end of the epoch, without dropout.
    pub validation_loss: f64,
    /// Whether no epoch before had a smaller validation loss.
    pub best: bool,
}

/// A trained network and the way there.
#[derive(Clone, Debug)]
pub struct Trained {
    /// The network of the epoch with the smallest validation loss.
    pub network: Network,
    /// Every epoch, in order.
    pub epochs: Vec<Epoch>,
}

/// Why nothing was trained.
#[derive(Debug, Error)]
pub enum TrainError {
    /// A part of the dataset is too small.
    #[error("the {part} part has {found} rows, at least {allowed} are needed")]
    TooFewRows {
        /// Part of the dataset.
        part: &'static str,
        /// Rows found.
        found: usize,
        /// Rows needed.
        allowed: usize,
    },
    /// A row has a value that is NaN or infinite.
    #[error("row {row} of the {part} part has {value} as {what}; drop such rows first")]
    NotFinite {
        /// Part of the dataset.
        part: &'static str,
        /// Position of the row.
        row: usize,
        /// Feature or target.
        what: &'static str,
        /// The value found.
        value: f32,
    },
    /// A setting is out of range.
    #[error("`{setting}` is {found}, allowed: {allowed}")]
    Setting {
        /// Name of the setting.
        setting: &'static str,
        /// The value found.
        found: f64,
        /// What is accepted.
        allowed: &'static str,
    },
    /// The power never changes, so there is nothing to learn.
    #[error("the power of all {rows} training rows is {power_w} W; a varying power is needed")]
    ConstantPower {
        /// Number of training rows.
        rows: usize,
        /// Their power.
        power_w: f32,
    },
    /// The finished network was refused.
    #[error("the finished network was refused")]
    Model(#[from] ModelError),
}

/// Trains a network. `progress` is told of each epoch when it ends.
pub fn train(
    dataset: &Dataset,
    settings: &Settings,
    mut progress: impl FnMut(Epoch),
) -> Result<Trained, TrainError> {
    check(dataset, settings)?;
    let normalisation = normalisation(&dataset.training, settings.feature_set)?;
    let examples = |rows: &[Row]| -> Vec<Example> {
        rows.iter()
            .map(|row| Example::new(row, &normalisation, settings.feature_set))
            .collect()
    };
    let (training, validation) = (examples(&dataset.training), examples(&dataset.validation));

    let mut noise = Noise::new(settings.seed, 0);
    let mut weights = Weights::initial(settings.feature_set.inputs(), &mut noise);
    let mut adam = Adam::new(weights.values.len());
    let mut workspace = Workspace::new(&weights);
    let mut order: Vec<usize> = (0..training.len()).collect();
    let mut best = (f64::INFINITY, weights.clone());
    let mut epochs: Vec<Epoch> = Vec::new();
    let mut without_progress = 0;
    for number in 1..=settings.max_epochs {
        shuffle(&mut order, &mut noise);
        let mut summed_loss = 0.0;
        for batch in order.chunks(BATCH) {
            workspace.clear();
            for &index in batch {
                let Example { inputs, target } = &training[index];
                workspace.draw_dropout(settings.dropout, &mut noise);
                summed_loss += workspace.accumulate(&weights, inputs, *target);
            }
            adam.step(&mut weights.values, &workspace.gradients, batch.len());
        }
        workspace.keep_everything();
        let validation_loss = mean_loss(&validation, &weights, &mut workspace);
        let training_loss = summed_loss / training.len() as f64;
        let is_best = validation_loss < best.0;
        let epoch = Epoch {
            number,
            training_loss,
            validation_loss,
            best: is_best,
        };
        progress(epoch);
        epochs.push(epoch);
        if is_best {
            best = (validation_loss, weights.clone());
            without_progress = 0;
        } else {
            without_progress += 1;
            if without_progress >= settings.patience {
                break;
            }
        }
    }
    let network = finished(dataset, settings, normalisation, &best.1)?;
    Ok(Trained { network, epochs })
}

/// A normalised row.
struct Example {
    inputs: Vec<f64>,
    target: f64,
}

impl Example {
    fn new(row: &Row, normalisation: &Normalisation, feature_set: FeatureSet) -> Example {
        let Normalisation {
            feature_mean,
            feature_std,
            power_mean_w,
            power_std_w,
        } = normalisation;
        let scaled = |value: f32, mean: f32, std: f32| {
            let std = f64::from(std);
            if std > 0.0 {
                (f64::from(value) - f64::from(mean)) / std
            } else {
                0.0
            }
        };
        Example {
            inputs: (feature_set.first()..FEATURES)
                .map(|i| scaled(row.features[i], feature_mean[i], feature_std[i]))
                .collect(),
            target: scaled(row.target_w, *power_mean_w, *power_std_w),
        }
    }
}

fn mean_loss(examples: &[Example], weights: &Weights, workspace: &mut Workspace) -> f64 {
    let losses = examples.iter().map(|Example { inputs, target }| {
        let error = workspace.forward(weights, inputs) - target;
        error * error
    });
    losses.sum::<f64>() / examples.len() as f64
}

fn shuffle(order: &mut [usize], noise: &mut Noise) {
    for last in (1..order.len()).rev() {
        order.swap(last, noise.below(last + 1));
    }
}

/// Adam (Kingma and Ba 2015) with its bias corrections.
struct Adam {
    first: Vec<f64>,
    second: Vec<f64>,
    first_left: f64,
    second_left: f64,
}

impl Adam {
    fn new(parameters: usize) -> Adam {
        Adam {
            first: vec![0.0; parameters],
            second: vec![0.0; parameters],
            first_left: 1.0,
            second_left: 1.0,
        }
    }

    fn step(&mut self, values: &mut [f64], summed_gradients: &[f64], batch: usize) {
        self.first_left *= FIRST_MOMENT;
        self.second_left *= SECOND_MOMENT;
        let moments = self.first.iter_mut().zip(&mut self.second);
        for ((value, gradient), (first, second)) in
            values.iter_mut().zip(summed_gradients).zip(moments)
        {
            let gradient = gradient / batch as f64;
            *first = FIRST_MOMENT * *first + (1.0 - FIRST_MOMENT) * gradient;
            *second = SECOND_MOMENT * *second + (1.0 - SECOND_MOMENT) * gradient * gradient;
            let mean = *first / (1.0 - self.first_left);
            let scale = libm::sqrt(*second / (1.0 - self.second_left)) + ADAM_EPSILON;
            *value -= LEARNING_RATE * mean / scale;
        }
    }
}

fn check(dataset: &Dataset, settings: &Settings) -> Result<(), TrainError> {
    let Dataset {
        training,
        validation,
        held_out,
        ..
    } = dataset;
    for (part, rows, allowed) in [
        ("training", training, BATCH),
        ("validation", validation, 1),
        ("held-out", held_out, 2),
    ] {
        if rows.len() < allowed {
            return Err(TrainError::TooFewRows {
                part,
                found: rows.len(),
                allowed,
            });
        }
        for (row, Row { features, target_w }) in rows.iter().enumerate() {
            let names = joulebus_predictor::FEATURE_NAMES.into_iter().zip(features);
            let read = names
                .skip(settings.feature_set.first())
                .chain([("target", target_w)]);
            for (what, &value) in read {
                if !value.is_finite() {
                    return Err(TrainError::NotFinite {
                        part,
                        row,
                        what,
                        value,
                    });
                }
            }
        }
    }
    if !(0.0..1.0).contains(&settings.dropout) {
        let allowed = "from 0 up to but not including 1";
        return Err(TrainError::Setting {
            setting: "dropout",
            found: settings.dropout,
            allowed,
        });
    }
    if settings.max_epochs == 0 {
        return Err(TrainError::Setting {
            setting: "max_epochs",
            found: 0.0,
            allowed: "at least 1",
        });
    }
    Ok(())
}

fn normalisation(rows: &[Row], feature_set: FeatureSet) -> Result<Normalisation, TrainError> {
    let mut feature_mean = [0.0; FEATURES];
    let mut feature_std = [0.0; FEATURES];
    for i in feature_set.first()..FEATURES {
        (feature_mean[i], feature_std[i]) = mean_and_std(rows.iter().map(|row| row.features[i]));
    }
    let (power_mean_w, power_std_w) = mean_and_std(rows.iter().map(|row| row.target_w));
    if power_std_w > 0.0 {
        Ok(Normalisation {
            feature_mean,
            feature_std,
            power_mean_w,
            power_std_w,
        })
    } else {
        Err(TrainError::ConstantPower {
            rows: rows.len(),
            power_w: power_mean_w,
        })
    }
}

/// In two passes; the deviation of equal values is exactly 0.
fn mean_and_std(values: impl Iterator<Item = f32> + Clone) -> (f32, f32) {
    let count = values.clone().count() as f64;
    let mean = values.clone().map(f64::from).sum::<f64>() / count;
    let first = values.clone().next();
    if values.clone().all(|value| Some(value) == first) {
        return (mean as f32, 0.0);
    }
    let squares = values.map(|value| (f64::from(value) - mean) * (f64::from(value) - mean));
    (mean as f32, libm::sqrt(squares.sum::<f64>() / count) as f32)
}

fn finished(
    dataset: &Dataset,
    settings: &Settings,
    normalisation: Normalisation,
    weights: &Weights,
) -> Result<Network, TrainError> {
    let feature_set = settings.feature_set;
    let parameters = Parameters {
        feature_set,
        normalisation,
        layers: weights.layers(),
    };
    let mut card = Card {
        name: settings.name.clone(),
        source: settings.source.clone(),
        training_data: dataset.description.clone(),
        training_data_sha256: dataset.sha256(),
        seed: settings.seed,
        training_range: training_range(&dataset.training, feature_set),
        residual: ResidualStats {
            std_w: 0.0,
            q05_w: 0.0,
            q95_w: 0.0,
        },
        scores: Scores {
            rows: 0,
            network_r2: 0.0,
            network_mae_w: 0.0,
            persistence_r2: 0.0,
            persistence_mae_w: 0.0,
        },
    };
    // The finished arithmetic gives the scores, so the network is built once without them.
    let unscored = Network::new(parameters.clone(), card.clone())?;
    (card.scores, card.residual) = scored(&unscored, &dataset.held_out);
    Ok(Network::new(parameters, card)?)
}

fn training_range(rows: &[Row], feature_set: FeatureSet) -> TrainingRange {
    let mut min = [0.0; FEATURES];
    let mut max = [0.0; FEATURES];
    for i in feature_set.first()..FEATURES {
        let values = || rows.iter().map(|row| row.features[i]);
        min[i] = values().fold(f32::INFINITY, f32::min);
        max[i] = values().fold(f32::NEG_INFINITY, f32::max);
    }
    TrainingRange {
        feature_set,
        min,
        max,
    }
}

/// Scores and residuals of a network on rows, with persistence beside it.
pub fn scored(network: &Network, rows: &[Row]) -> (Scores, ResidualStats) {
    let inputs: Vec<Features> = rows.iter().map(|row| row.features).collect();
    let mut forecasts_w = vec![0.0; rows.len()];
    network.predict(&inputs, &mut forecasts_w);
    let last_w: Vec<f32> = inputs
        .iter()
        .map(|features| features[FeatureSet::PowerOnly.first()])
        .collect();

    let count = rows.len() as f64;
    let mean_w = rows.iter().map(|row| f64::from(row.target_w)).sum::<f64>() / count;
    let spread =
        |row: &Row| (f64::from(row.target_w) - mean_w) * (f64::from(row.target_w) - mean_w);
    let total: f64 = rows.iter().map(spread).sum();
    let errors = |forecasts_w: &[f32]| -> Vec<f64> {
        let pairs = rows.iter().zip(forecasts_w);
        pairs
            .map(|(row, &forecast_w)| f64::from(row.target_w) - f64::from(forecast_w))
            .collect()
    };
    let r2 = |errors: &[f64]| (1.0 - errors.iter().map(|e| e * e).sum::<f64>() / total) as f32;
    let mae_w = |errors: &[f64]| (errors.iter().map(|e| e.abs()).sum::<f64>() / count) as f32;

    let (mut network_errors, persistence_errors) = (errors(&forecasts_w), errors(&last_w));
    let scores = Scores {
        rows: rows.len() as u64,
        network_r2: r2(&network_errors),
        network_mae_w: mae_w(&network_errors),
        persistence_r2: r2(&persistence_errors),
        persistence_mae_w: mae_w(&persistence_errors),
    };
    let (_, std_w) = mean_and_std(network_errors.iter().map(|&error| error as f32));
    network_errors.sort_by(f64::total_cmp);
    let quantile = |share: f64| {
        let position = (share * (count - 1.0)).max(0.0) as usize;
        network_errors
            .get(position)
            .map_or(f32::NAN, |&error| error as f32)
    };
    (
        scores,
        ResidualStats {
            std_w,
            q05_w: quantile(0.05),
            q95_w: quantile(0.95),
        },
    )
}
