//! A training run, epoch by epoch.

use std::fmt;

use fearless_simd::{Level, dispatch};
use joulebus_predictor::training::TrainedRows;
use joulebus_predictor::{Network, Normalisation};
use rayon::iter::{IndexedParallelIterator as _, ParallelIterator as _};
use rayon::slice::{ParallelSlice as _, ParallelSliceMut as _};
use rayon::{ThreadPool, ThreadPoolBuilder};
use serde::{Deserialize, Serialize};

use super::adam::Adam;
use super::chunk::{Chunk, Example, Prepared, ROWS};
use super::energy::{FEWEST_RECORDINGS, recordings};
use super::prepare::{Findings, constant_features, normalisation, usable, without_known};
use super::score::finished;
use super::weights::Weights;
use super::{TrainError, TrainSettings};
use joulebus_dataset::rows::{Dataset, Row};
use joulebus_dataset::trained_rows::trained_rows;
use joulebus_statistics::noise::Noise;

/// Minimum number of rows for training and for scoring.
const FEWEST_ROWS: usize = 2;
/// Maximum number of threads of a run.
const MAX_THREADS: usize = 256;
/// Random streams: initial weights, row order of an epoch, dropout.
const INITIAL: u64 = 0;
const ORDER: u64 = 1 << 62;
const DROPOUT: u64 = 1 << 63;

/// Result of an epoch. Losses are mean squared errors in units of the training variance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Epoch {
    /// Number, from 1.
    pub number: u32,
    /// Loss over the training rows, with dropout and with the weights as they changed.
    pub training_loss: f64,
    /// Loss over the validation rows at the end of the epoch, without dropout.
    pub validation_loss: f64,
    /// True if no earlier epoch has a lower validation loss.
    pub best: bool,
}

/// A trained network and its training history.
#[derive(Clone, Debug)]
pub struct Trained {
    /// The network of the epoch with the lowest validation loss.
    pub network: Network,
    /// Every epoch, in order.
    pub epochs: Vec<Epoch>,
    /// Irregularities of the data.
    pub findings: Findings,
}

/// A training run. The same dataset and settings give the same bytes, on every machine, with any
/// number of threads, and whether or not the run was saved and resumed.
pub struct Training {
    pub(super) dataset: Dataset,
    trained_rows: Option<TrainedRows>,
    pub(super) settings: TrainSettings,
    findings: Findings,
    normalisation: Normalisation,
    training: Vec<Example>,
    validation: Vec<Example>,
    pub(super) weights: Weights,
    pub(super) adam: Adam,
    pub(super) best: Weights,
    pub(super) epochs: Vec<Epoch>,
    prepared: Prepared,
    chunks: Vec<Chunk>,
    gradients: Vec<f32>,
    losses: Vec<f64>,
    level: Level,
    pool: ThreadPool,
}

impl fmt::Debug for Training {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("Training")
            .field("settings", &self.settings)
            .field("findings", &self.findings)
            .field("epochs", &self.epochs)
            .finish_non_exhaustive()
    }
}

impl Training {
    /// Prepares a run on `threads` threads, 0 for one per core. Rows with a NaN or infinite number
    /// are left out: [`Training::findings`].
    ///
    /// # Errors
    /// [`TrainError`]: a setting out of range, too few rows, or constant power.
    pub fn new(
        dataset: &Dataset,
        settings: &TrainSettings,
        threads: usize,
    ) -> Result<Self, TrainError> {
        settings.check()?;
        if threads > MAX_THREADS {
            let reason = format!("allowed are 0, one per core, to {MAX_THREADS}");
            return Err(TrainError::Threads { threads, reason });
        }
        // Count over all rows: dropping an unusable row would cut the run of readings around it.
        let trained_rows = trained_rows(dataset);
        let (dataset, known) = without_known(dataset, trained_rows.as_ref());
        let (dataset, unusable_rows) = usable(&dataset, settings.feature_set);
        if known.held_out > 0 && dataset.held_out.len() < FEWEST_ROWS {
            let of = known.held_out + dataset.held_out.len() + unusable_rows[2];
            return Err(TrainError::HeldOutTrainedOn { known: known.held_out, of });
        }
        check_rows(&dataset, unusable_rows)?;
        let normalisation = normalisation(&dataset.training, settings.feature_set)?;
        let examples = |rows: &[Row]| -> Vec<Example> {
            rows.iter().map(|row| Example::new(row, &normalisation, settings.feature_set)).collect()
        };
        let (training, validation) = (examples(&dataset.training), examples(&dataset.validation));
        let mut noise = Noise::new(settings.seed, INITIAL);
        let weights = Weights::initial(settings.feature_set.inputs(), &mut noise);
        let pool = ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .map_err(|error| TrainError::Threads { threads, reason: error.to_string() })?;
        let parts = settings.batch.min(training.len()).div_ceil(ROWS);
        let recordings = recordings(&dataset);
        Ok(Self {
            findings: Findings {
                unusable_rows,
                held_out_trained_on: known.held_out,
                held_out_untold: known.held_out_untold,
                validation_trained_on: known.validation,
                constant_features: constant_features(&normalisation, settings.feature_set),
                training_rows: training.len(),
                few_rows: training.len() < weights.values.len(),
                recordings,
                few_recordings: recordings < FEWEST_RECORDINGS,
            },
            adam: Adam::new(weights.values.len()),
            prepared: Prepared::new(&weights),
            chunks: (0..parts).map(|_| Chunk::new(&weights)).collect(),
            gradients: vec![0.0; weights.values.len()],
            losses: vec![0.0; parts],
            best: weights.clone(),
            epochs: Vec::new(),
            level: Level::new(),
            settings: settings.clone(),
            dataset,
            trained_rows,
            normalisation,
            training,
            validation,
            weights,
            pool,
        })
    }

    /// Irregularities of the data that were worked around.
    pub fn findings(&self) -> &Findings {
        &self.findings
    }

    /// The epochs so far, including those before a resumption.
    pub fn epochs(&self) -> &[Epoch] {
        &self.epochs
    }

    /// True if the run has reached the maximum number of epochs or stopped early.
    pub fn is_done(&self) -> bool {
        let made = self.epochs.len();
        let best = self.epochs.iter().rposition(|epoch| epoch.best);
        let without_progress = best.map_or(0, |best| made - 1 - best);
        made >= self.settings.max_epochs as usize
            || without_progress >= self.settings.patience as usize
    }

    /// Runs one epoch.
    ///
    /// # Errors
    /// [`TrainError::Diverged`].
    pub fn epoch(&mut self) -> Result<Epoch, TrainError> {
        let number = self.epochs.len() as u32 + 1;
        let mut noise = Noise::new(self.settings.seed, ORDER + u64::from(number));
        let mut order: Vec<u32> = (0..self.training.len() as u32).collect();
        shuffle(&mut order, &mut noise);
        let mut summed_loss = 0.0;
        for (place, rows) in order.chunks(self.settings.batch).enumerate() {
            summed_loss +=
                self.step(rows, DROPOUT + (u64::from(number) << 32) + ((place as u64) << 12));
        }
        let validation_loss = self.validate();
        if !validation_loss.is_finite() {
            return Err(TrainError::Diverged { epoch: number, loss: validation_loss });
        }
        let before = self.epochs.iter().map(|epoch| epoch.validation_loss);
        let best = before.fold(f64::INFINITY, f64::min);
        let epoch = Epoch {
            number,
            training_loss: summed_loss / self.training.len() as f64,
            validation_loss,
            best: validation_loss < best,
        };
        if epoch.best {
            self.best.values.copy_from_slice(&self.weights.values);
        }
        self.epochs.push(epoch);
        Ok(epoch)
    }

    /// The network of the best epoch, with its scores on the held-out rows.
    ///
    /// # Errors
    /// [`TrainError::Model`] when the predictor refuses it.
    pub fn finish(self) -> Result<Trained, TrainError> {
        let network = finished(
            &self.dataset,
            &self.settings,
            self.trained_rows,
            self.normalisation,
            &self.best,
        )?;
        Ok(Trained { network, epochs: self.epochs, findings: self.findings })
    }

    /// Trains one batch. Its parts are computed in parallel and their gradients added in order.
    /// Returns the summed loss.
    fn step(&mut self, rows: &[u32], stream: u64) -> f64 {
        let Self { training, weights, prepared, chunks, losses, settings, level, .. } = self;
        let (weights, prepared, training, level) = (&*weights, &*prepared, &*training, *level);
        let dropped = (settings.dropout * 65_536.0).round().min(65_535.0) as u16;
        let seed = settings.seed;
        let parts = rows.len().div_ceil(ROWS);
        let work = chunks[..parts]
            .par_chunks_mut(1)
            .zip(losses[..parts].par_chunks_mut(1))
            .zip(rows.par_chunks(ROWS))
            .enumerate();
        self.pool.install(|| {
            work.for_each(|(part, ((chunk, loss), rows))| {
                let (chunk, loss) = (&mut chunk[0], &mut loss[0]);
                let mut noise = Noise::new(seed, stream + part as u64);
                chunk.draw_dropout(dropped, rows.len(), &mut noise);
                let rows = rows.iter().map(|row| &training[*row as usize]);
                *loss = dispatch!(level, simd => chunk.learn(simd, weights, prepared, rows));
            });
        });
        self.gradients.fill(0.0);
        for chunk in &self.chunks[..parts] {
            for (sum, gradient) in self.gradients.iter_mut().zip(&chunk.gradients) {
                *sum += gradient;
            }
        }
        let share = 1.0 / rows.len() as f32;
        let hyperparameters = self.settings.hyperparameters();
        self.adam.step(&mut self.weights.values, &self.gradients, share, hyperparameters);
        self.prepared.update(&self.weights);
        self.losses[..parts].iter().sum()
    }

    fn validate(&mut self) -> f64 {
        let Self { validation, weights, chunks, level, .. } = self;
        let chunk = &mut chunks[0];
        chunk.keep_everything();
        let losses = validation.chunks(ROWS).map(|rows| {
            let level = *level;
            dispatch!(level, simd => chunk.measure(simd, weights, rows.iter()))
        });
        losses.sum::<f64>() / validation.len() as f64
    }

    /// Restores the weights of a saved run.
    pub(super) fn set_weights(&mut self, values: &[f32]) {
        self.weights.values.copy_from_slice(values);
        self.prepared.update(&self.weights);
    }
}

/// Trains a network on all cores. `progress` is called after each epoch.
///
/// # Errors
/// [`TrainError`].
pub fn train(
    dataset: &Dataset,
    settings: &TrainSettings,
    mut progress: impl FnMut(Epoch),
) -> Result<Trained, TrainError> {
    let mut training = Training::new(dataset, settings, 0)?;
    while !training.is_done() {
        progress(training.epoch()?);
    }
    training.finish()
}

fn shuffle(order: &mut [u32], noise: &mut Noise) {
    for last in (1..order.len()).rev() {
        order.swap(last, noise.below(last + 1));
    }
}

fn check_rows(dataset: &Dataset, unusable_rows: [usize; 3]) -> Result<(), TrainError> {
    let parts = [
        ("training", &dataset.training),
        ("validation", &dataset.validation),
        ("held-out", &dataset.held_out),
    ];
    for ((part, rows), unusable) in parts.into_iter().zip(unusable_rows) {
        if rows.len() < FEWEST_ROWS {
            return Err(TrainError::TooFewRows {
                part,
                found: rows.len(),
                unusable,
                allowed: FEWEST_ROWS,
            });
        }
    }
    Ok(())
}
