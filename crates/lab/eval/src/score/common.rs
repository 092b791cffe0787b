//! The common inputs of all parts of an evaluation: everything known before the recordings are run.

use joulebus_predictor::Model;
use joulebus_train::linear::LinearReport;
use serde::Serialize;

use super::cell::Names;
use super::design::{DesignReport, Lines};
use super::members::Member;
use super::tallied::Listed;
use super::trained_on::{Recognised, ScoredRows, TrainedOn};
use super::{Options, ScoreError, Subject};
use crate::energy::EnergyErrors;
use crate::evaluate::Forecast;

/// An evaluation without its sums.
#[derive(Debug)]
pub(super) struct Common {
    pub(super) platform: String,
    pub(super) models: Vec<ModelReport>,
    pub(super) scored_rows: ScoredRows,
    pub(super) untold_rows: usize,
    pub(super) design: DesignReport,
    pub(super) baselines: Vec<BaselineReport>,
    pub(super) names: Names,
    pub(super) recordings: Vec<Listed>,
}

/// A model that was evaluated.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModelReport {
    /// Its name.
    pub name: String,
    /// Its hash, hexadecimal.
    pub hash: String,
    /// The origin of the forecast that was scored one tick ahead.
    pub forecast: Forecast,
    /// Names of the forecast's members in the tables. Empty for a single forecaster.
    pub members: Vec<String>,
    /// Its training data as stated in its file. `None` for persistence.
    pub training_data: Option<String>,
    /// The rows that it was trained on, among those that were to be evaluated. `None` if its file
    /// does not state them.
    pub trained_on: Option<TrainedOn>,
    /// Errors of its energy forecasts of the evaluated rows. `None` if not
    /// [asked for](Options::energy).
    pub energy: Option<EnergyErrors>,
}

/// A linear baseline.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BaselineReport {
    /// Its name.
    pub name: String,
    /// The linear model of the first fold. `None` if there were too few rows to fit it on.
    pub line: Option<LinearReport>,
    /// Folds in which it could be fitted.
    pub fitted_folds: usize,
}

impl Common {
    pub(super) fn new(
        subject: Subject<'_>,
        options: &Options,
        lines: &Lines,
    ) -> Result<Self, ScoreError> {
        let Subject { models, recordings, design, .. } = subject;
        let names = names(subject, options);
        let platform = subject.platform.map(|platform| platform.name.clone());
        let evaluated = 0..models.len();
        let recognised = Recognised::new(recordings, models)?;
        Ok(Self {
            platform: platform.unwrap_or_else(|| "recorded".to_owned()),
            models: evaluated.map(|at| model(at, subject, &names, &recognised)).collect(),
            scored_rows: design.scored_rows(&recognised),
            design: design.report(),
            untold_rows: design.untold_rows(&recognised),
            baselines: baselines(options, lines),
            names,
            recordings: recordings.iter().map(Listed::new).collect(),
        })
    }
}

/// A model before its forecasts of energy are scored.
fn model(at: usize, subject: Subject<'_>, names: &Names, recognised: &Recognised) -> ModelReport {
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
        trained_on: subject.design.trained_on(recognised, at),
        energy: None,
    }
}

/// Names of the forecasters. Models of the same name are distinguished by their hashes.
fn names(subject: Subject<'_>, options: &Options) -> Names {
    let models = subject.models;
    let base = |model: &Model| {
        let is_twice = models.iter().filter(|other| other.name() == model.name()).count() > 1;
        match is_twice {
            true => format!("{} {:08x}", model.name(), model.hash() >> 32),
            false => model.name().to_owned(),
        }
    };
    let named = models.iter().map(|model| match subject.forecast(model) {
        Forecast::Persistence => "persistence (model)".to_owned(),
        forecast => format!("{} ({forecast})", base(model)),
    });
    let baselines = options.baselines.iter().map(ToString::to_string);
    let mut forecasters: Vec<String> =
        named.chain(["persistence".to_owned()]).chain(baselines).collect();
    let first = forecasters.len();
    forecasters.extend(options.references.iter().map(ToString::to_string));
    let references = options.references.iter().enumerate();
    let with_interval = references.filter(|(_, reference)| reference.has_interval());
    let with_interval = with_interval.map(|(at, _)| first + at);
    let intervals = (0..models.len()).chain(with_interval).collect();
    let baselines = forecasters.len() - models.len();
    let members = Member::of(subject).into_iter();
    forecasters
        .extend(members.map(|(at, member)| format!("{} ({})", base(&models[at]), member.name())));
    Names {
        forecasters,
        models: models.len(),
        baselines,
        intervals,
        nominal: f64::from(subject.settings.interval.coverage),
    }
}

/// Names of the members of a model's forecast.
fn members(at: usize, subject: Subject<'_>, names: &Names) -> Vec<String> {
    let first = names.models + names.baselines;
    let all = Member::of(subject).into_iter().zip(&names.forecasters[first..]);
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
