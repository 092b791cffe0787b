//! The readings used to evaluate conventions, and the scores of each.

use joulebus_dataset::rows::Row;
use joulebus_dataset::trial::{Column, Trial};
use joulebus_predictor::{
    FEATURES, FeatureSet, Features, LAGS, ModelCard, Network, ResidualStats, Scores, TrainingRange,
    features,
};

use crate::error::ImportError;

/// Maximum number of readings per block: ten seconds at 30 Hz.
const BLOCK_ROWS: usize = 300;
/// Number of blocks of few readings: enough to tell chance from a difference.
const MIN_BLOCKS: usize = 20;
/// Minimum number of readings for a choice.
const MIN_ROWS: usize = 100;
/// Maximum number of readings that are forecast. If there are more, every n-th block is used.
const MAX_ROWS: usize = 60_000;
/// A step longer than this many median steps is a gap.
const MAX_STEP: f64 = 1.5;

/// Rows of features and the readings that followed.
pub(super) struct Data {
    rows: Vec<Row>,
    /// Median step of the first trial, s.
    pub(super) step_s: f64,
    trials: usize,
}

/// Score of a network on the data.
pub(super) struct Score {
    pub(super) r2: f64,
    pub(super) mae_w: f64,
    /// Summed squared error of each block.
    squared: Vec<f64>,
    /// Reading minus forecast, W.
    residuals_w: Vec<f32>,
}

impl Score {
    pub(super) fn blocks(&self) -> usize {
        self.squared.len()
    }

    /// Share by which the other's squared error is larger.
    pub(super) fn excess_of(&self, other: &Score) -> f64 {
        let sum = |score: &Score| score.squared.iter().sum::<f64>();
        sum(other) / sum(self) - 1.0
    }

    /// Number of blocks in which this score has the smaller error.
    pub(super) fn blocks_won(&self, other: &Score) -> usize {
        let pairs = self.squared.iter().zip(&other.squared);
        pairs.filter(|(own, others)| own < others).count()
    }
}

impl Data {
    pub(super) fn new(trials: &[Trial], set: FeatureSet) -> Result<Data, ImportError> {
        let mut rows: Vec<Row> = trials.iter().flat_map(|trial| rows(trial, set)).collect();
        if rows.len() > MAX_ROWS {
            let every = rows.len().div_ceil(MAX_ROWS);
            let blocks = rows.chunks(BLOCK_ROWS).step_by(every);
            rows = blocks.flatten().copied().collect();
        }
        let found = rows.len();
        if found < MIN_ROWS {
            let allowed = MIN_ROWS;
            return Err(ImportError::TooFewRows { found, allowed });
        }
        if rows.iter().all(|row| row.target_w == rows[0].target_w) {
            return Err(ImportError::ConstantPower { rows: found });
        }
        let period_ns = trials.first().map_or(1, Trial::period_ns);
        Ok(Data { rows, step_s: period_ns as f64 * 1e-9, trials: trials.len() })
    }

    pub(super) fn rows(&self) -> usize {
        self.rows.len()
    }

    /// Forecasts every reading. `centre` is subtracted from the velocities before their magnitudes
    /// are taken.
    pub(super) fn score(&self, network: &Network, centre: Option<[f32; 2]>) -> Score {
        let inputs: Vec<Features> = self
            .rows
            .iter()
            .map(|row| {
                let mut inputs = row.features;
                if let Some([v_mps, omega_radps]) = centre {
                    inputs[4] = (inputs[0] - v_mps).abs();
                    inputs[5] = (inputs[1] - omega_radps).abs();
                }
                inputs
            })
            .collect();
        let mut forecasts_w = vec![0.0; inputs.len()];
        network.predict(&inputs, &mut forecasts_w);
        let residuals = self.rows.iter().zip(&forecasts_w);
        let residuals_w: Vec<f32> =
            residuals.map(|(row, forecast_w)| row.target_w - forecast_w).collect();
        self.score_of(residuals_w)
    }

    fn persistence(&self) -> Score {
        let lag = |row: &Row| row.target_w - row.features[FEATURES - LAGS];
        self.score_of(self.rows.iter().map(lag).collect())
    }

    fn score_of(&self, residuals_w: Vec<f32>) -> Score {
        let count = self.rows.len() as f64;
        let targets = || self.rows.iter().map(|row| f64::from(row.target_w));
        let mean = targets().sum::<f64>() / count;
        let spread: f64 = targets().map(|power| (power - mean).powi(2)).sum();
        let square = |residual: &f32| f64::from(*residual).powi(2);
        let block_rows = (self.rows.len() / MIN_BLOCKS).clamp(1, BLOCK_ROWS);
        let blocks = residuals_w.chunks(block_rows);
        let squared: Vec<f64> = blocks.map(|block| block.iter().map(square).sum()).collect();
        let absolute: f64 = residuals_w.iter().map(|r| f64::from(r.abs())).sum();
        let r2 = 1.0 - squared.iter().sum::<f64>() / spread;
        Score {
            // Forecasts that are NaN rank last.
            r2: if r2.is_nan() { f64::NEG_INFINITY } else { r2 },
            mae_w: absolute / count,
            squared,
            residuals_w,
        }
    }

    /// The card of an imported network, with statistics measured on these data.
    pub(super) fn card(
        &self,
        set: FeatureSet,
        score: &Score,
        name: &str,
        source: String,
    ) -> ModelCard {
        let persistence = self.persistence();
        let features = self.rows.iter().map(|row| &row.features);
        let (rows, trials) = (self.rows.len(), self.trials);
        ModelCard {
            name: name.to_owned(),
            source,
            training_data: format!(
                "not stated by the file; range, residuals and scores are of the {rows} readings of \
                 {trials} trials on which it was imported, and may be of its training"
            ),
            step_s: Some(self.step_s as f32),
            residual: residual(&score.residuals_w),
            scores: Scores {
                rows: rows as u64,
                network_r2: score.r2 as f32,
                network_mae_w: score.mae_w as f32,
                persistence_r2: persistence.r2 as f32,
                persistence_mae_w: persistence.mae_w as f32,
            },
            ..ModelCard::new(TrainingRange::of(set, features))
        }
    }
}

/// Standard deviation and quantiles of at least one residual.
fn residual(residuals_w: &[f32]) -> ResidualStats {
    let count = residuals_w.len() as f64;
    let mean = residuals_w.iter().map(|r| f64::from(*r)).sum::<f64>() / count;
    let square = |r: &f32| (f64::from(*r) - mean).powi(2);
    let variance = residuals_w.iter().map(square).sum::<f64>() / count;
    let mut sorted = residuals_w.to_vec();
    sorted.sort_by(f32::total_cmp);
    let quantile = |share: f64| sorted[(share * (count - 1.0)).round() as usize];
    ResidualStats { std_w: variance.sqrt() as f32, q05_w: quantile(0.05), q95_w: quantile(0.95) }
}

/// The rows of a trial: the command of a row, the derivative over the step before, the readings of
/// the five rows before, newest first, and its own reading. A row needs six gapless rows, and rows
/// that lack an input of the network are left out.
fn rows(trial: &Trial, set: FeatureSet) -> Vec<Row> {
    let missing: &[f64] = &[];
    let column = |column| trial.column(column).unwrap_or(missing);
    let (v, omega, power) = (column(Column::V), column(Column::Omega), column(Column::Power));
    let at = |column: &[f64], row: usize| column.get(row).map_or(f32::NAN, |value| *value as f32);
    let longest_s = trial.period_ns() as f64 * 1e-9 * MAX_STEP;
    let step_s = |row: usize| {
        let ns = trial.offset_ns();
        (ns[row] - ns[row - 1]) as f64 * 1e-9
    };
    let is_even = |row: usize| step_s(row) > 0.0 && step_s(row) <= longest_s;
    let mut rows = Vec::new();
    let mut even = 0;
    for row in 1..trial.rows() {
        even = if is_even(row) { even + 1 } else { 0 };
        if even < LAGS {
            continue;
        }
        let lag_w: [f32; LAGS] = std::array::from_fn(|lag| at(power, row - 1 - lag));
        let before = Some((at(v, row - 1), at(omega, row - 1), step_s(row) as f32));
        let features = features(at(v, row), at(omega, row), before, &lag_w);
        let target_w = at(power, row);
        let is_whole = features[set.range()].iter().all(|value| value.is_finite());
        if is_whole && target_w.is_finite() {
            rows.push(Row::new(features, target_w));
        }
    }
    rows
}
