//! `joulebus.evaluate`.

use joulebus_config::Config;
use joulebus_eval::EvalReport;
use joulebus_eval::evaluate::{RobotEvaluation, Series};
use joulebus_eval::score::{Options, Recording, Reference, Scored, Subject, score_watched};
use joulebus_program::config_file::ConfigFile;
use joulebus_statistics::bootstrap::Bootstrap;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde::Deserialize;

use super::recordings::Inputs;
use super::{Choice, job, json, models, refused, settings};
use crate::array::array;
use crate::error::ConnectError;
use crate::recordings::{Given, Reading, refused_trial};

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct EvaluationRequest {
    choice: Choice,
    energy: bool,
    resamples: u32,
    confidence: f64,
    block_rows: usize,
}

impl EvaluationRequest {
    fn options(&self) -> Options {
        Options {
            energy: self.energy,
            references: Reference::OWN.to_vec(),
            bootstrap: Bootstrap {
                resamples: self.resamples,
                confidence: self.confidence,
                seed: self.choice.seed,
                block_rows: self.block_rows,
                ..Bootstrap::default()
            },
            ..Options::default()
        }
    }
}

/// Progress of an evaluation.
enum Progress {
    Remark(String),
    /// Recordings done, of all.
    Done(usize, usize),
}

/// Settings of the live path: those that the verbs have.
pub(super) fn config() -> PyResult<Config> {
    ConfigFile { config: None }.read().map_err(|error| ConnectError::new_err(error.to_string()))
}

/// An evaluation: its JSON, its text, and the live series of each model's trials. `remark` gets
/// what was left out of directories, `progress` the numbers of recordings done and of all.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "arguments of one call in Python")]
pub(crate) fn evaluate<'py>(
    py: Python<'py>,
    recordings: &Bound<'py, PyAny>,
    fit: &Bound<'py, PyAny>,
    reading: Given,
    given_models: &Bound<'py, PyAny>,
    asked: &str,
    remark: &Bound<'py, PyAny>,
    progress: &Bound<'py, PyAny>,
) -> PyResult<(String, String, Vec<Bound<'py, PyDict>>)> {
    let (inputs, fit, reading) =
        (Inputs::new(recordings)?, Inputs::new(fit)?, Reading::new(reading)?);
    let asked: EvaluationRequest = settings(asked)?;
    let models = models(given_models)?;
    let config = config()?;
    let work = move |reporter: &job::Reporter<Progress>| {
        let remark = |text| {
            let _ = reporter.report(Progress::Remark(text));
        };
        let recordings = inputs.recordings(&reading, |id| id, remark)?;
        let fit = fit.recordings(&reading, |id| id, remark)?;
        let options = asked.options();
        let design = asked.choice.design(&recordings, fit, &models)?;
        let subject = Subject {
            settings: config.settings(),
            platform: None,
            models: &models,
            recordings: &recordings,
            design: &design,
        };
        let all = recordings.len();
        let watch = |done| reporter.report(Progress::Done(done, all));
        let scored = score_watched(subject, &options, watch).map_err(refused)?;
        Ok((scored, recordings))
    };
    let (scored, recordings) = job::run(py, work, |news| match news {
        Progress::Remark(text) => remark.call1((text,)).map(|_| ()),
        Progress::Done(done, all) => progress.call1((done, all)).map(|_| ()),
    })?;
    let Scored { report, live, .. } = scored;
    let robots = live.iter().flat_map(|live| &live.robots);
    let series = robots.map(|robot| series(py, robot, &recordings));
    let series = series.collect::<PyResult<Vec<_>>>()?;
    let report = EvalReport { evaluations: vec![report] };
    Ok((json(&report)?, report.to_string(), series))
}

/// Trips of the recordings as JSON, as of `joulebus eval --trips`. `remark` as of [`evaluate`].
#[pyfunction]
pub(crate) fn trips(
    py: Python<'_>,
    recordings: &Bound<'_, PyAny>,
    reading: Given,
    remark: &Bound<'_, PyAny>,
) -> PyResult<String> {
    let (inputs, reading) = (Inputs::new(recordings)?, Reading::new(reading)?);
    let work = move |reporter: &job::Reporter<String>| {
        let remark = |text| {
            let _ = reporter.report(text);
        };
        let recordings = inputs.recordings(&reading, |id| id, remark)?;
        json(&joulebus_eval::trips::trips(&recordings).map_err(|error| refused_trial(&error))?)
    };
    job::run(py, work, |text| remark.call1((text,)).map(|_| ()))
}

/// The scored readings of a trial and their forecasts.
fn series<'py>(
    py: Python<'py>,
    robot: &RobotEvaluation,
    recordings: &[Recording],
) -> PyResult<Bound<'py, PyDict>> {
    let (found, dict) = (Series::new(robot), PyDict::new(py));
    let recording = recordings.iter().find(|one| one.id == robot.robot);
    dict.set_item("trial", recording.map(|one| one.name.clone()))?;
    dict.set_item("model", &robot.model)?;
    let shape = [found.len()];
    for (name, values) in [
        ("time_s", found.time_s),
        ("reading_w", found.reading_w),
        ("forecast_w", found.forecast_w),
        ("lo_w", found.lo_w),
        ("hi_w", found.hi_w),
    ] {
        dict.set_item(name, array(py, values, &shape)?)?;
    }
    Ok(dict)
}
