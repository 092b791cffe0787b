//! All scores of an evaluation.

use joulebus_predictor::Model;
use rayon::prelude::*;
use serde::Serialize;

use super::blocks::{Set, Tallied};
use super::cell::{Cell, HorizonCell, Names, cell, horizon_cell};
use super::design::{DesignReport, Lines};
use super::members::Member;
use super::trained_on::{ScoredRows, TrainedOn, warnings};
use super::{Options, Recording, Subject};
use crate::energy::{EnergyErrors, EnergyScores};
use crate::evaluate::Forecast;
use joulebus_statistics::bootstrap::Bootstrap;
use joulebus_train::linear::LinearReport;

/// An evaluation: data, models, baselines and scores. `Display` gives tables; in JSON, undefined
/// scores are null.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScoreReport {
    /// Name of the platform; `recorded` where period and limits are the recordings'.
    pub platform: String,
    /// The models, in order.
    pub models: Vec<ModelReport>,
    /// What the rows of all tables but `trained_on` are to the models.
    pub scored_rows: ScoredRows,
    /// What must be known before the scores are read.
    pub warnings: Vec<String>,
    /// Which rows were evaluated.
    pub design: DesignReport,
    /// The linear baselines, in order.
    pub baselines: Vec<BaselineReport>,
    /// Configuration of the confidence intervals.
    pub bootstrap: Bootstrap,
    /// Median period of the recordings, s.
    pub period_s: f64,
    /// Corrected mode, all recordings.
    pub all: Cell,
    /// Corrected mode, rows that a model was trained on, where they are scored apart.
    pub trained_on: Option<Cell>,
    /// By group; empty if there is only one.
    pub groups: Vec<Cell>,
    /// By robot; empty if there is only one.
    pub robots: Vec<Cell>,
    /// By trial; empty if there is only one.
    pub trials: Vec<Cell>,
    /// Rows from one origin of the open loop to the next; at shorter horizons, as many as the horizon has ticks.
    pub origins_every: usize,
    /// Open loop, all recordings.
    pub open_loop: HorizonCell,
    /// By group; empty if there is only one.
    pub open_loop_groups: Vec<HorizonCell>,
    /// By robot; empty if there is only one.
    pub open_loop_robots: Vec<HorizonCell>,
    /// By trial; empty if there is only one.
    pub open_loop_trials: Vec<HorizonCell>,
}

/// A model that was evaluated.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModelReport {
    /// Its name.
    pub name: String,
    /// Its hash, hexadecimal.
    pub hash: String,
    /// Whose forecast was scored one tick ahead; open loop is the network's alone.
    pub forecast: Forecast,
    /// Names in the tables of what the forecast is combined from; empty if it is one forecaster's.
    pub members: Vec<String>,
    /// Its training data as stated in its file; `None` for persistence.
    pub training_data: Option<String>,
    /// The rows that it was trained on, among those that were to be evaluated. `None` if its file does not state
    /// them.
    pub trained_on: Option<TrainedOn>,
    /// Errors of its energy forecasts of the evaluated rows; `None` if not
    /// [asked for](Options::energy).
    pub energy: Option<EnergyErrors>,
}

/// A linear baseline.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BaselineReport {
    /// Its name.
    pub name: String,
    /// The linear model of the first fold; `None` if there were too few rows to fit it on.
    pub line: Option<LinearReport>,
    /// Folds in which it could be fitted.
    pub fitted_folds: usize,
}

pub(super) fn report(
    subject: Subject<'_>,
    options: &Options,
    lines: &Lines,
    [tallied, apart]: [&Tallied; 2],
) -> ScoreReport {
    let names = names(subject, options);
    let tables = |sets: Vec<Set>| -> (Vec<Cell>, Vec<HorizonCell>) {
        let sets = if sets.len() > 1 { sets } else { Vec::new() };
        let of = |set: &Set| {
            (
                cell(tallied, set, &names, options),
                horizon_cell(tallied, set, &names, options),
            )
        };
        sets.par_iter().map(of).unzip()
    };
    let models = 0..subject.models.len();
    let models: Vec<ModelReport> = models
        .map(|at| of_model(at, subject, &names, options))
        .collect();
    let design = subject.design;
    let scored_rows = design.scored_rows(subject.recordings, subject.models);
    let stated = models.iter();
    let stated = stated.map(|model| (model.name.as_str(), model.trained_on));
    let all = tallied.all();
    let (groups, open_loop_groups) = tables(tallied.groups());
    let (robots, open_loop_robots) = tables(tallied.robots());
    let (trials, open_loop_trials) = tables(tallied.trials());
    ScoreReport {
        platform: subject
            .platform
            .map_or_else(|| "recorded".to_owned(), |platform| platform.name.clone()),
        scored_rows,
        warnings: warnings(stated, scored_rows),
        models,
        design: design.report(),
        baselines: baselines(options, lines),
        bootstrap: options.bootstrap,
        period_s: tallied.period_s(),
        all: cell(tallied, &all, &names, options),
        trained_on: (apart.rows() > 0).then(|| cell(apart, &apart.all(), &names, options)),
        groups,
        robots,
        trials,
        origins_every: options.origins_every,
        open_loop: horizon_cell(tallied, &all, &names, options),
        open_loop_groups,
        open_loop_robots,
        open_loop_trials,
    }
}

/// Names of the forecasters; models of the same name are distinguished by their hashes.
pub(super) fn names(subject: Subject<'_>, options: &Options) -> Names {
    let models = subject.models;
    let base = |model: &Model| {
        let is_twice = models
            .iter()
            .filter(|other| other.name() == model.name())
            .count()
            > 1;
        match is_twice {
            true => format!("{} {:08x}", model.name(), model.hash() >> 32),
            false => model.name().to_owned(),
        }
    };
    let of = |forecast: &dyn Fn(&Model) -> Forecast| -> Vec<String> {
        let named = models.iter().map(|model| match forecast(model) {
            Forecast::Persistence => "persistence (model)".to_owned(),
            forecast => format!("{} ({forecast})", base(model)),
        });
        let baselines = options.baselines.iter().map(ToString::to_string);
        named
            .chain(["persistence".to_owned()])
            .chain(baselines)
            .collect()
    };
    let mut forecasters = of(&|model| subject.forecast(model));
    let members = Member::of(subject).into_iter();
    forecasters
        .extend(members.map(|(at, member)| format!("{} ({})", base(&models[at]), member.name())));
    Names {
        forecasters,
        open_loop: of(&|model| Forecast::of(model, false)),
        models: models.len(),
        baselines: 1 + options.baselines.len(),
        nominal: f64::from(subject.settings.interval.coverage),
    }
}

fn of_model(at: usize, subject: Subject<'_>, names: &Names, options: &Options) -> ModelReport {
    let model = &subject.models[at];
    let card = match model {
        Model::Network(network) => Some(network.card()),
        Model::Persistence(_) => None,
    };
    ModelReport {
        name: model.name().to_owned(),
        hash: format!("{:016x}", model.hash()),
        forecast: subject.forecast(model),
        members: members(at, subject, names),
        training_data: card.map(|card| card.training_data.clone()),
        trained_on: subject.design.trained_on(subject.recordings, model),
        energy: options.energy.then(|| energy(model, subject)),
    }
}

/// The energy of the rows that are evaluated.
fn energy(model: &Model, subject: Subject<'_>) -> EnergyErrors {
    let of = |(at, recording): (usize, &Recording)| {
        let mut scored = vec![false; recording.trial.rows()];
        let parts = subject.design.evaluated(at).map(|(_, part)| part);
        for row in parts.flatten() {
            // The target of a row is the reading of the sample after its own.
            let target = recording.rows.sample_seq[row] as usize + 1;
            if let Some(scored) = scored.get_mut(target) {
                *scored = true;
            }
        }
        let mut scores = EnergyScores::default();
        scores.add(model, &recording.trial, &scored);
        scores
    };
    let each = subject.recordings.par_iter().enumerate().map(of);
    // In the recordings' order, so that sums are the same on any number of threads.
    let mut all = EnergyScores::default();
    for scores in each.collect::<Vec<_>>() {
        all.append(scores);
    }
    all.errors()
}

/// Names of what a model's forecast is combined from.
fn members(at: usize, subject: Subject<'_>, names: &Names) -> Vec<String> {
    let first = names.models + names.baselines;
    let all = Member::of(subject)
        .into_iter()
        .zip(&names.forecasters[first..]);
    let own = all.filter(|((model, _), _)| *model == at);
    let own: Vec<String> = own.map(|(_, name)| name.clone()).collect();
    match own.is_empty() {
        true => own,
        false => [vec![names.forecasters[names.models].clone()], own].concat(),
    }
}

fn baselines(options: &Options, lines: &Lines) -> Vec<BaselineReport> {
    let each = options.baselines.iter().enumerate();
    each.map(|(at, terms)| {
        let fitted = lines.iter().filter_map(|lines| lines[at].as_ref());
        BaselineReport {
            name: terms.to_string(),
            fitted_folds: fitted.clone().count(),
            line: fitted.map(joulebus_train::linear::Linear::report).next(),
        }
    })
    .collect()
}
