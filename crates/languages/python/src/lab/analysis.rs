//! `joulebus.analyze`.

use joulebus_eval::analyze::{AnalysisSettings, analyze as analyze_recordings};
use joulebus_eval::score::ROWS_IN_MEMORY;
use joulebus_predictor::Model;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::recordings::Inputs;
use super::{job, json, models, settings};
use crate::recordings::{Given, Reading};

/// The analysis of recordings as JSON. `remark` is called with what was left out of directories.
#[pyfunction]
pub(crate) fn analyze(
    py: Python<'_>,
    recordings: &Bound<'_, PyAny>,
    reading: Given,
    asked: &str,
    given_models: &Bound<'_, PyAny>,
    remark: &Bound<'_, PyAny>,
) -> PyResult<String> {
    let (inputs, reading) = (Inputs::new(recordings)?, Reading::new(reading)?);
    let asked: AnalysisSettings = settings(asked)?;
    let named = |model: Model| (format!("network {}", model.name()), model);
    let models: Vec<(String, Model)> = models(given_models)?.into_iter().map(named).collect();
    let work = move |reporter: &job::Reporter<String>| {
        let remark = |remark| {
            let _ = reporter.report(remark);
        };
        let recordings = inputs.open(&reading, |id| id, ROWS_IN_MEMORY, remark)?;
        let analysis = analyze_recordings(&recordings, &asked, &models);
        let analysis = analysis.map_err(|error| PyValueError::new_err(error.to_string()))?;
        json(&analysis)
    };
    job::run(py, work, |text| remark.call1((text,)).map(|_| ()))
}
