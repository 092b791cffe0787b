//! The lab: the computations of `train`, `eval`, `analyze`, `report` and `data simulate`.
//!
//! Settings arrive as JSON and results leave as JSON, with the names and numbers of the verbs'
//! `--format json`. Each computation has a thread of its own while Python's looks at signals
//! ([`job`]).

mod analysis;
mod evaluation;
mod job;
mod recordings;
mod report;
mod simulation;
mod training;

pub(crate) use analysis::analyze;
pub(crate) use evaluation::{evaluate, trips};
pub(crate) use report::{Report, report_recorded, report_simulated};
pub(crate) use simulation::simulate;
pub(crate) use training::{train_recordings, train_simulated};

use std::path::PathBuf;

use joulebus_dataset::split::{By, Split};
use joulebus_eval::score::{Design, Recording, ScoreError, check_apart};
use joulebus_predictor::Model;
use pyo3::exceptions::{PyRuntimeError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::predictor::Predictor;

/// The settings of a call, as Python passes them.
fn settings<T: DeserializeOwned>(json: &str) -> PyResult<T> {
    serde_json::from_str(json).map_err(|error| {
        // The place in the JSON is not the caller's.
        let text = error.to_string();
        let what = text.split(" at line ").next().unwrap_or(&text);
        PyValueError::new_err(what.to_owned())
    })
}

fn json(result: &impl Serialize) -> PyResult<String> {
    serde_json::to_string(result).map_err(|error| PyRuntimeError::new_err(error.to_string()))
}

/// Models: files, built-in ones, or predictors.
fn models(given: &Bound<'_, PyAny>) -> PyResult<Vec<Model>> {
    let model = |given: PyResult<Bound<'_, PyAny>>| {
        let given = given?;
        if let Ok(predictor) = given.cast::<Predictor>() {
            return Ok(predictor.get().model().as_ref().clone());
        }
        let path: PathBuf = given.extract().map_err(|_| {
            PyTypeError::new_err(format!(
                "a model is {given}, allowed are paths, builtin:NAME and Predictor"
            ))
        })?;
        Ok(Model::Network(crate::model::open(&path)?))
    };
    given.try_iter()?.map(model).collect()
}

/// The rows that are evaluated, and those that the baselines are fitted on.
#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Choice {
    /// None: all rows.
    split: Option<By>,
    held_out: f64,
    leave_out: Vec<String>,
    seed: u64,
}

impl Choice {
    fn split(&self, by: By) -> Split {
        Split { by, held_out: self.held_out, seed: self.seed, ..Split::default() }
    }

    /// `fit`: recordings that the baselines are fitted on, if any.
    fn design(
        &self,
        recordings: &[Recording],
        fit: Vec<Recording>,
        models: &[Model],
    ) -> PyResult<Design> {
        let design = match (self.split, self.leave_out.as_slice()) {
            (Some(by), []) => Design::held_out(recordings, self.split(by)).map_err(refused)?,
            (Some(by), names) => {
                Design::leaving_out(recordings, self.split(by), names).map_err(refused)?
            }
            (None, _) if fit.is_empty() => Design::folds(recordings),
            (None, _) => {
                check_apart(recordings, (&fit, "in fit"))
                    .map_err(|error| PyValueError::new_err(error.to_string()))?;
                Design::fitted_on(recordings, fit)
            }
        };
        design.hold_apart(recordings, models).map_err(refused)
    }
}

fn refused(error: ScoreError) -> PyErr {
    PyValueError::new_err(error.to_string())
}
