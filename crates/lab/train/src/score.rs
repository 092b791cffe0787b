//! The trained network and its scores on held-out rows.

use joulebus_energy::EnergyModel;
use joulebus_predictor::training::{SIMULATED, TrainedRows};
use joulebus_predictor::{
    Activation, FeatureSet, Features, INPUTS, Linear, ModelCard, Network, Normalisation,
    Parameters, ResidualStats, Scores, TrainingRange,
};

use super::prepare::mean_and_std;
use super::weights::Weights;
use super::{TrainError, TrainSettings};
use crate::energy::energy_model;
use crate::linear::Terms;
use joulebus_dataset::rows::{Dataset, Row};
use joulebus_statistics::metrics::{Tally, quantile};

pub(super) fn finished(
    dataset: &Dataset,
    settings: &TrainSettings,
    trained_rows: Option<TrainedRows>,
    normalisation: Normalisation,
    weights: &Weights,
) -> Result<Network, TrainError> {
    let feature_set = settings.feature_set;
    let parameters = Parameters {
        feature_set,
        normalisation,
        activation: Activation::GeluErf,
        layers: weights.layers(),
    };
    let rows = dataset.training.iter().map(|row| &row.features);
    let mut card = ModelCard {
        name: settings.name.clone(),
        source: settings.source.clone(),
        training_data: dataset.description.clone(),
        training_data_sha256: dataset.sha256(feature_set),
        trained_rows,
        seed: settings.seed,
        // Files of simulated robots have the bytes that they had: their source states the step.
        step_s: (settings.source != SIMULATED && dataset.period_s > 0.0)
            .then_some(dataset.period_s),
        linear: linear(dataset),
        energy: energy(dataset, settings),
        ..ModelCard::new(TrainingRange::of(feature_set, rows))
    };
    // The final arithmetic gives the scores, so the network is first built without them.
    let unscored = Network::new(parameters.clone(), card.clone())?;
    // Files of simulated robots have the bytes that they had: ledgers and captures name the shipped
    // models by their hash.
    let share = if settings.source == SIMULATED { at_row_below } else { quantile };
    (card.scores, card.residual) = scored_with(&unscored, &dataset.held_out, share);
    Ok(Network::new(parameters, card)?)
}

/// The energy model, with what the recipe states of the recordings.
fn energy(dataset: &Dataset, settings: &TrainSettings) -> Option<EnergyModel> {
    let mut energy = energy_model(dataset, settings.feature_set)?;
    if settings.source == SIMULATED {
        // Files of simulated robots have the bytes that they had.
        return Some(EnergyModel { ridge: None, recorded_w: None, limits: Vec::new(), ..energy });
    }
    energy.limits.extend(&settings.limits);
    energy.hotel_w = settings.hotel_w;
    Some(energy)
}

/// The linear baseline fitted on the training rows, with its score on the held-out rows. `None` if
/// there are too few rows, or their power is constant.
fn linear(dataset: &Dataset) -> Option<Linear> {
    let fitted = crate::linear::Linear::fit(&dataset.training, Terms::AR5).ok()?;
    let mut weights = [0.0; INPUTS];
    for (feature, coefficient) in fitted.coefficients() {
        weights[*feature] = *coefficient as f32;
    }
    let mut linear = Linear {
        feature_set: FeatureSet::PowerOnly,
        bias_w: fitted.intercept_w() as f32,
        weights,
        r2: 0.0,
    };
    let mut scores = Tally::default();
    for row in &dataset.held_out {
        scores.add(row.target_w.into(), linear.predict(&row.features).into(), 0.0);
    }
    linear.r2 = scores.r2() as f32;
    linear.check().is_ok().then_some(linear)
}

/// The number at a share of ascending ones or the one below it, as the shipped models state it.
fn at_row_below(ascending: &[f64], share: f64) -> f64 {
    let last = ascending.len().saturating_sub(1);
    ascending.get((share * last as f64) as usize).copied().unwrap_or(f64::NAN)
}

/// Scores and residuals of a network on rows, with the scores of persistence.
pub fn scored(network: &Network, rows: &[Row]) -> (Scores, ResidualStats) {
    scored_with(network, rows, quantile)
}

/// Same as [`scored`], with the quantile that `share` finds in ascending numbers.
fn scored_with(
    network: &Network,
    rows: &[Row],
    share: fn(&[f64], f64) -> f64,
) -> (Scores, ResidualStats) {
    let inputs: Vec<Features> = rows.iter().map(|row| row.features).collect();
    let mut forecasts_w = vec![0.0; rows.len()];
    network.predict(&inputs, &mut forecasts_w);
    let last_w: Vec<f32> =
        inputs.iter().map(|features| features[FeatureSet::PowerOnly.first()]).collect();

    let count = rows.len() as f64;
    let mean_w = rows.iter().map(|row| f64::from(row.target_w)).sum::<f64>() / count;
    let spread =
        |row: &Row| (f64::from(row.target_w) - mean_w) * (f64::from(row.target_w) - mean_w);
    let total: f64 = rows.iter().map(spread).sum();
    let errors = |forecasts_w: &[f32]| -> Vec<f64> {
        let pairs = rows.iter().zip(forecasts_w);
        pairs.map(|(row, &forecast_w)| f64::from(row.target_w) - f64::from(forecast_w)).collect()
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
    let [q05_w, q95_w] = [0.05, 0.95].map(|of| share(&network_errors, of) as f32);
    (scores, ResidualStats { std_w, q05_w, q95_w })
}
