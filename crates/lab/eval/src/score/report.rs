//! All scores of an evaluation.

use std::io;

use rayon::prelude::*;
use serde::Serialize;

use super::Options;
use super::cell::{Cell, cell};
use super::common::{BaselineReport, Common, ModelReport};
use super::design::DesignReport;
use super::tallied::{Set, Tallied};
use super::trained_on::{ScoredRows, warnings};
use crate::energy::EnergyScores;
use crate::evaluate::LeftOut;
use joulebus_statistics::bootstrap::Bootstrap;

/// An evaluation: data, models, baselines and scores. `Display` gives tables. In JSON, undefined
/// scores are null.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScoreReport {
    /// Name of the platform. `recorded` if period and limits are the recordings'.
    pub platform: String,
    /// The models, in order.
    pub models: Vec<ModelReport>,
    /// Relation of the rows of all tables but `trained_on` to the models' training.
    pub scored_rows: ScoredRows,
    /// Rows of these tables that are not recognised, in pieces too short, or that change too
    /// rarely, to be recognised as trained on.
    pub untold_rows: usize,
    /// Warnings for the reader of the scores.
    pub warnings: Vec<String>,
    /// The rows that were evaluated.
    pub design: DesignReport,
    /// The linear baselines, in order.
    pub baselines: Vec<BaselineReport>,
    /// Configuration of the confidence intervals.
    pub bootstrap: Bootstrap,
    /// Median period of the recordings, s.
    pub period_s: f64,
    /// Corrected mode, all recordings.
    pub all: Cell,
    /// Corrected mode on rows that a model was trained on, if they are scored apart.
    pub trained_on: Option<Cell>,
    /// Cells by group. Empty if there is only one.
    pub groups: Vec<Cell>,
    /// Cells by robot. Empty if there is only one.
    pub robots: Vec<Cell>,
    /// Cells by trial. Empty if there is only one.
    pub trials: Vec<Cell>,
    /// Samples that were refused, or that got no forecast of the first model.
    pub left_out: Vec<LeftOut>,
}

/// The tables, from sums of the recordings and each model's forecasts of energy.
///
/// # Errors
/// Residuals cannot be read from their temporary file.
pub(super) fn report(
    common: Common,
    options: &Options,
    [tallied, apart]: [&Tallied; 2],
    energy: &[EnergyScores],
) -> io::Result<ScoreReport> {
    let Common { mut models, names, .. } = common;
    let names = &names;
    let tables = |sets: Vec<Set>| -> io::Result<Vec<Cell>> {
        let sets = if sets.len() > 1 { sets } else { Vec::new() };
        sets.par_iter().map(|set| cell(tallied, set, names, options)).collect()
    };
    for (model, scores) in models.iter_mut().zip(energy) {
        model.energy = Some(scores.errors());
    }
    let stated = models.iter();
    let stated = stated.map(|model| (model.name.as_str(), model.trained_on));
    let trained_on = (apart.rows() > 0).then(|| cell(apart, &apart.all(), names, options));
    Ok(ScoreReport {
        platform: common.platform,
        scored_rows: common.scored_rows,
        untold_rows: common.untold_rows,
        warnings: warnings(stated, common.scored_rows),
        models,
        design: common.design,
        baselines: common.baselines,
        bootstrap: options.bootstrap,
        period_s: tallied.period_s(),
        all: cell(tallied, &tallied.all(), names, options)?,
        trained_on: trained_on.transpose()?,
        groups: tables(tallied.groups())?,
        robots: tables(tallied.robots())?,
        trials: tables(tallied.trials())?,
        left_out: Vec::new(),
    })
}
