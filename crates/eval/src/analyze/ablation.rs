//! Gain of each kind of input to a forecast, on new and on held readings.

use joulebus_predictor::{Features, Model};
use serde::Serialize;

use joulebus_dataset::rows::Row;
use joulebus_dataset::split::{Assignment, Source};
use joulebus_dataset::trial::Trial;
use joulebus_statistics::metrics::Tally;
use joulebus_train::linear::{Linear, Terms};

/// Forecasts of the same held-out readings by models with more or fewer inputs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Ablation {
    /// Rows that the linear models were fitted on: those of training and validation.
    pub fitted_rows: usize,
    /// Held-out rows, each with a forecast of every model.
    pub rows: usize,
    /// Of these, readings equal to the previous one to the bit.
    pub held_rows: usize,
    /// Rows of both parts left out because a velocity is missing.
    pub unusable_rows: usize,
    /// Mean of the held-out readings, W.
    pub power_mean_w: f64,
    /// Standard deviation of the held-out readings, W.
    pub power_std_w: f64,
    /// The models.
    pub members: Vec<Member>,
}

/// A model and its scores.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Member {
    /// Its name: `persistence`, `velocities + 1 lag`, a model's name.
    pub name: String,
    /// On all held-out readings.
    pub all: Part,
    /// On readings equal to the previous one.
    pub held: Part,
    /// On the other readings.
    pub new: Part,
    /// Reduction of squared error against the mean of all held-out readings: the share of that
    /// reduction on held readings. NaN without a reduction.
    pub held_share_of_gain: f64,
}

/// Scores on a part of the readings. NaN where the part has no variance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Part {
    /// Readings.
    pub rows: u64,
    /// Coefficient of determination, about the mean of the part.
    pub r2: f64,
    /// Mean absolute error, W.
    pub mae_w: f64,
    /// Root of the mean squared error, W.
    pub rmse_w: f64,
}

/// The held-out readings.
struct HeldOut {
    rows: Vec<Row>,
    held: Vec<bool>,
}

/// The ablation, and what was skipped, with reasons.
pub(super) fn ablation(
    trials: &[Trial],
    sources: &[Source],
    assignment: &Assignment,
    window: usize,
    models: &[(String, Model)],
) -> (Option<Ablation>, Vec<String>) {
    let mut skipped = Vec::new();
    let has_velocities = sources
        .iter()
        .flat_map(|source| &source.rows.rows)
        .any(|row| velocities_known(&row.features));
    let usable = |row: &Row| {
        row.target_w.is_finite() && (!has_velocities || velocities_known(&row.features))
    };
    let (fitted, held_out, unusable_rows) = gather(trials, sources, assignment, usable);
    let wanted = if has_velocities {
        vec![
            Terms::VELOCITIES,
            Terms::velocities_and_lags(1),
            Terms::velocities_and_lags(window),
            Terms::lags(1),
            Terms::lags(window),
        ]
    } else {
        skipped.push("models with velocities: no trial has recorded them".to_owned());
        vec![Terms::lags(1), Terms::lags(window)]
    };
    let readings: Vec<f64> = held_out
        .rows
        .iter()
        .map(|row| f64::from(row.target_w))
        .collect();
    let baseline = tally_of(&readings, &readings);
    if held_out.rows.len() < 2 {
        skipped.push("the ablation: fewer than two rows are held out".to_owned());
        return (None, skipped);
    }
    let persistence = Linear::persistence();
    let mut members = vec![member(
        "persistence",
        &held_out,
        &persistence.predict_rows(&held_out.rows),
    )];
    let mut wanted = wanted;
    wanted.dedup();
    for terms in wanted {
        match Linear::fit(&fitted, terms) {
            Ok(line) => {
                let forecasts_w = line.predict_rows(&held_out.rows);
                members.push(member(&terms.to_string(), &held_out, &forecasts_w));
            }
            Err(error) => skipped.push(format!("{terms}: {error}")),
        }
    }
    for (name, model) in models {
        let forecasts_w = predict(model, &held_out.rows);
        if forecasts_w.iter().all(|forecast_w| forecast_w.is_finite()) {
            members.push(member(name, &held_out, &forecasts_w));
        } else {
            skipped.push(format!(
                "{name}: it reads velocities, which are not recorded"
            ));
        }
    }
    let found = Ablation {
        fitted_rows: fitted.len(),
        rows: held_out.rows.len(),
        held_rows: held_out.held.iter().filter(|held| **held).count(),
        unusable_rows,
        power_mean_w: baseline.reading_mean_w(),
        power_std_w: baseline.reading_std_w(),
        members,
    };
    (Some(found), skipped)
}

fn velocities_known(features: &Features) -> bool {
    Terms::VELOCITIES
        .features()
        .all(|feature| features[feature].is_finite())
}

/// The rows to fit on, the held-out rows, and the number of unusable rows.
fn gather(
    trials: &[Trial],
    sources: &[Source],
    assignment: &Assignment,
    usable: impl Fn(&Row) -> bool,
) -> (Vec<Row>, HeldOut, usize) {
    let mut fitted = Vec::new();
    let mut held_out = HeldOut {
        rows: Vec::new(),
        held: Vec::new(),
    };
    let mut unusable = 0;
    for ((trial, source), [training, validation, last]) in
        trials.iter().zip(sources).zip(&assignment.ranges)
    {
        let rows = &source.rows.rows;
        for row in training.clone().chain(validation.clone()) {
            match usable(&rows[row]) {
                true => fitted.push(rows[row]),
                false => unusable += 1,
            }
        }
        for row in last.clone() {
            if usable(&rows[row]) {
                held_out.rows.push(rows[row]);
                let sample = source.rows.sample_seq[row];
                held_out.held.push(target_is_held(trial, sample));
            } else {
                unusable += 1;
            }
        }
    }
    (fitted, held_out, unusable)
}

fn predict(model: &Model, rows: &[Row]) -> Vec<f64> {
    let inputs: Vec<Features> = rows.iter().map(|row| row.features).collect();
    let mut forecasts_w = vec![0.0; rows.len()];
    model.predict(&inputs, &mut forecasts_w);
    forecasts_w.into_iter().map(f64::from).collect()
}

fn tally_of(readings_w: &[f64], forecasts_w: &[f64]) -> Tally {
    joulebus_statistics::metrics::tally(readings_w, forecasts_w, f64::NAN)
}

fn member(name: &str, held_out: &HeldOut, forecasts_w: &[f64]) -> Member {
    let pairs = || {
        let readings = held_out.rows.iter().map(|row| f64::from(row.target_w));
        readings.zip(forecasts_w).zip(&held_out.held)
    };
    let (mut all, mut parts) = (Tally::default(), [Tally::default(); 2]);
    for ((reading_w, forecast_w), held) in pairs() {
        all.add(reading_w, *forecast_w, f64::NAN);
        parts[usize::from(*held)].add(reading_w, *forecast_w, f64::NAN);
    }
    let mean_w = all.reading_mean_w();
    // Reduction of squared error against the mean of all readings, on new and on held ones.
    let mut gain_w2 = [0.0; 2];
    for ((reading_w, forecast_w), held) in pairs() {
        let (from_mean, from_forecast) = (reading_w - mean_w, reading_w - forecast_w);
        gain_w2[usize::from(*held)] += from_mean * from_mean - from_forecast * from_forecast;
    }
    let total_w2 = gain_w2[0] + gain_w2[1];
    Member {
        name: name.to_owned(),
        all: Part::of(&all),
        held: Part::of(&parts[1]),
        new: Part::of(&parts[0]),
        held_share_of_gain: if total_w2 > 0.0 {
            gain_w2[1] / total_w2
        } else {
            f64::NAN
        },
    }
}

impl Part {
    fn of(tally: &Tally) -> Self {
        Self {
            rows: tally.count(),
            r2: tally.r2(),
            mae_w: tally.mae_w(),
            rmse_w: tally.rmse_w(),
        }
    }
}

/// Whether the target reading of a sample's forecast equals the one before it.
fn target_is_held(trial: &Trial, sample_seq: u64) -> bool {
    usize::try_from(sample_seq).is_ok_and(|sample| trial.is_held(sample + 1))
}
