//! `joulebus.report`.

use joulebus_eval::score::Reference;
use joulebus_predictor::Network;
use joulebus_report::{
    Document, Recorded, ReportError, Simulated, SimulatedReport, files, html, recorded, simulated,
};
use joulebus_settings::bounds;
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use serde::Deserialize;

use super::evaluation::config;
use super::recordings::Inputs;
use super::{Choice, job, json, models, settings};
use crate::recordings::{Given, Reading};

#[pyclass(module = "joulebus._native", frozen)]
#[derive(Debug)]
pub(crate) struct Report {
    document: Document,
    /// The network of simulated experiments.
    network: Option<Network>,
}

#[pymethods]
impl Report {
    /// The contents of `report.json`.
    fn json(&self) -> PyResult<String> {
        json(&self.document)
    }

    fn text(&self) -> String {
        self.document.to_string()
    }

    /// One page that needs no other file.
    fn html(&self, py: Python<'_>) -> PyResult<String> {
        let page = py.detach(|| html(&self.document));
        page.map_err(|error| PyRuntimeError::new_err(error.to_string()))
    }

    /// The files of a report's directory: paths below it, and contents.
    fn files<'py>(&self, py: Python<'py>) -> PyResult<Vec<(String, Bound<'py, PyBytes>)>> {
        let files = py.detach(|| files(&self.document)).map_err(refused)?.into_iter();
        let bytes = |text: String| PyBytes::new(py, text.as_bytes());
        let mut files: Vec<_> =
            files.map(|file| (file.name.to_owned(), bytes(file.text))).collect();
        if let Some(bytes) = self.network(py)? {
            files.push(("network.safetensors".to_owned(), bytes));
        }
        Ok(files)
    }

    /// The model file of the network that simulated experiments show.
    fn network<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyBytes>>> {
        let bytes = self.network.as_ref().map(Network::to_safetensors);
        let bytes = bytes.transpose();
        let bytes = bytes.map_err(|error| PyValueError::new_err(error.to_string()))?;
        Ok(bytes.map(|bytes| PyBytes::new(py, &bytes)))
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ReportRequest {
    choice: Choice,
    battery_wh: Option<f64>,
}

/// A report on recordings. `remark` is called with what was left out of directories.
#[pyfunction]
pub(crate) fn report_recorded(
    py: Python<'_>,
    recordings: &Bound<'_, PyAny>,
    fit: &Bound<'_, PyAny>,
    reading: Given,
    given_models: &Bound<'_, PyAny>,
    asked: &str,
    remark: &Bound<'_, PyAny>,
) -> PyResult<Report> {
    let (inputs, fit, reading) =
        (Inputs::new(recordings)?, Inputs::new(fit)?, Reading::new(reading)?);
    let asked: ReportRequest = settings(asked)?;
    let allowed = bounds::BATTERY_CAPACITY_WH;
    if let Some(found) = asked.battery_wh.filter(|found| !allowed.contains(found)) {
        let (least, most) = (allowed.start(), allowed.end());
        let text = format!("battery_wh is {found}, allowed is {least} to {most}");
        return Err(PyValueError::new_err(text));
    }
    let models = models(given_models)?;
    let config = config()?;
    let work = move |reporter: &job::Reporter<String>| {
        let remark = |text| {
            let _ = reporter.report(text);
        };
        // Each is run alone: all have the same id.
        let recordings = inputs.recordings(&reading, |_| 0, remark)?;
        let fit = fit.recordings(&reading, |_| 0, remark)?;
        let design = asked.choice.design(&recordings, fit, &models)?;
        let document = recorded(&Recorded {
            settings: config.settings(),
            platform: None,
            models: &models,
            recordings: &recordings,
            design: &design,
            references: Reference::OWN.to_vec(),
            battery_wh: asked.battery_wh,
        });
        Ok(Report { document: document.map_err(refused)?, network: None })
    };
    job::run(py, work, |text| remark.call1((text,)).map(|_| ()))
}

/// A report on the paper's experiments with simulated robots. `progress` gets seed and epoch.
#[pyfunction]
pub(crate) fn report_simulated(
    py: Python<'_>,
    seed: u64,
    draws: u32,
    samples: usize,
    max_epochs: u32,
    progress: &Bound<'_, PyAny>,
) -> PyResult<Report> {
    let mut experiment = Simulated::new(seed);
    (experiment.samples, experiment.robot_steps) = (samples, samples);
    experiment.draws = draws;
    experiment.recipe.max_epochs = max_epochs;
    let config = config()?;
    let work = move |reporter: &job::Reporter<(u64, u32)>| {
        let report = simulated(&experiment, config.settings(), |seed, epoch| {
            reporter.report((seed, epoch.number))
        });
        let SimulatedReport { document, network, .. } = report.map_err(refused)?;
        Ok(Report { document, network: Some(network) })
    };
    job::run(py, work, |(seed, epoch)| progress.call1((seed, epoch)).map(|_| ()))
}

fn refused(error: ReportError) -> PyErr {
    PyValueError::new_err(error.to_string())
}
