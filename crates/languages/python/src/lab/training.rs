//! `joulebus.train`.

use std::path::Path;
use std::time::Instant;

use joulebus_dataset::rows::Dataset;
use joulebus_dataset::split::SplitSummary;
use joulebus_eval::score::{ROWS_IN_MEMORY, Recording};
use joulebus_eval::training_data::{MAX_ROWS, Parts, training_data};
use joulebus_predictor::FeatureSet;
use joulebus_sim::training_data::{SimulatedData, dataset_from_plant};
use joulebus_train::{Epoch, Recipe, TrainReport, TrainSettings, Training, settings_for_sim};
use pyo3::exceptions::{PyKeyboardInterrupt, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use serde::Deserialize;

use super::recordings::Inputs;
use super::{job, json, settings};
use crate::recordings::{Given, Reading};
use crate::training::{EpochRow, epoch_row, refused};

/// Arguments of `joulebus.train` beside a recipe. None: the recipe's.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct TrainingRequest {
    recipe: Option<String>,
    split: Option<joulebus_dataset::split::By>,
    seed: Option<u64>,
    name: Option<String>,
    feature_set: Option<String>,
    max_epochs: Option<u32>,
    patience: Option<u32>,
    threads: usize,
}

impl TrainingRequest {
    fn recipe(&self) -> PyResult<Recipe> {
        let recipe = self.recipe.as_deref().map(Recipe::parse).transpose();
        let recipe = recipe
            .map_err(|error| PyValueError::new_err(format!("the recipe is refused: {error}")))?;
        let mut recipe = recipe.unwrap_or_default();
        self.change(&mut recipe.training)?;
        if let Some(seed) = self.seed {
            recipe.split.seed = seed;
        }
        if let Some(by) = self.split {
            recipe.split.by = by;
        }
        Ok(recipe)
    }

    fn change(&self, training: &mut TrainSettings) -> PyResult<()> {
        if let Some(seed) = self.seed {
            training.seed = seed;
        }
        if let Some(name) = &self.name {
            training.name.clone_from(name);
        }
        if let Some(set) = &self.feature_set {
            training.feature_set = feature_set(set)?;
        }
        if let Some(max_epochs) = self.max_epochs {
            training.max_epochs = max_epochs;
        }
        if let Some(patience) = self.patience {
            training.patience = patience;
        }
        Ok(())
    }
}

fn feature_set(name: &str) -> PyResult<FeatureSet> {
    FeatureSet::from_name(name).ok_or_else(|| {
        let allowed = FeatureSet::ALL.map(FeatureSet::name).join(", ");
        PyValueError::new_err(format!("feature_set is {name}, allowed: {allowed}"))
    })
}

/// Progress of a training.
enum Progress {
    Remark(String),
    Epoch(Epoch),
}

/// The report's JSON and text, the model file's bytes, and the epochs.
type Made<'py> = (String, String, Bound<'py, PyBytes>, Vec<EpochRow>);

/// Trains on recordings, with a split of them or with parts of their own. `remark` is called with
/// what was left out of directories, `progress` with each epoch.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "arguments of one call in Python")]
pub(crate) fn train_recordings<'py>(
    py: Python<'py>,
    recordings: &Bound<'py, PyAny>,
    parts: (Bound<'py, PyAny>, Bound<'py, PyAny>),
    reading: Given,
    asked: &str,
    file: Option<String>,
    remark: &Bound<'py, PyAny>,
    progress: &Bound<'py, PyAny>,
) -> PyResult<Made<'py>> {
    let asked: TrainingRequest = settings(asked)?;
    let (recipe, threads, reading) = (asked.recipe()?, asked.threads, Reading::new(reading)?);
    let inputs = Inputs::new(recordings)?;
    let parts = [Inputs::new(&parts.0)?, Inputs::new(&parts.1)?];
    let prepare = move |reporter: &job::Reporter<Progress>| {
        let read = |inputs: Inputs| -> PyResult<Vec<Recording>> {
            let remark = |text| {
                let _ = reporter.report(Progress::Remark(text));
            };
            inputs.open(&reading, |id| id, ROWS_IN_MEMORY, remark)
        };
        let all = read(inputs)?;
        let [validation, held_out] = parts;
        let (validation, held_out) = (read(validation)?, read(held_out)?);
        let parts = match held_out.is_empty() {
            true => Parts::Split(&all, recipe.split),
            false => Parts::Given([&all, &validation, &held_out]),
        };
        let made = training_data(parts, MAX_ROWS.get());
        let (dataset, summary) = made.map_err(|error| PyValueError::new_err(error.to_string()))?;
        Ok((dataset, recipe.training, Some(summary)))
    };
    run(py, prepare, threads, file, remark, progress)
}

/// Trains on simulated robots, as the shipped models were.
#[pyfunction]
pub(crate) fn train_simulated<'py>(
    py: Python<'py>,
    asked: &str,
    file: Option<String>,
    remark: &Bound<'py, PyAny>,
    progress: &Bound<'py, PyAny>,
) -> PyResult<Made<'py>> {
    let asked: TrainingRequest = settings(asked)?;
    let set = asked.feature_set.as_deref().map_or(Ok(FeatureSet::Full), feature_set)?;
    let seed = asked.seed.unwrap_or_default();
    let mut training = settings_for_sim(seed, set);
    asked.change(&mut training)?;
    let threads = asked.threads;
    let prepare = move |_: &job::Reporter<Progress>| {
        let dataset = dataset_from_plant(SimulatedData::shipped(seed));
        Ok((dataset, training, None))
    };
    run(py, prepare, threads, file, remark, progress)
}

type Prepared = (Dataset, TrainSettings, Option<SplitSummary>);

fn run<'py>(
    py: Python<'py>,
    prepare: impl FnOnce(&job::Reporter<Progress>) -> PyResult<Prepared> + Send + 'static,
    threads: usize,
    file: Option<String>,
    remark: &Bound<'py, PyAny>,
    progress: &Bound<'py, PyAny>,
) -> PyResult<Made<'py>> {
    let work = move |reporter: &job::Reporter<Progress>| {
        let (dataset, settings, summary) = prepare(reporter)?;
        let begin = Instant::now();
        let mut training = Training::new(&dataset, &settings, threads).map_err(refused)?;
        while !training.is_done() {
            let epoch = training.epoch().map_err(refused)?;
            if reporter.report(Progress::Epoch(epoch)).is_break() {
                return Err(PyKeyboardInterrupt::new_err(()));
            }
        }
        let trained = training.finish().map_err(refused)?;
        let bytes = trained.network.to_safetensors();
        let bytes = bytes.map_err(|error| PyValueError::new_err(error.to_string()))?;
        let file = file.as_deref().map(Path::new);
        let report = TrainReport::new(file, &trained, begin.elapsed(), summary);
        Ok((json(&report)?, report.to_string(), bytes, trained.epochs))
    };
    let (json, text, bytes, epochs) = job::run(py, work, |news| match news {
        Progress::Remark(text) => remark.call1((text,)).map(|_| ()),
        Progress::Epoch(epoch) => progress.call1(epoch_row(epoch)).map(|_| ()),
    })?;
    let epochs = epochs.into_iter().map(epoch_row).collect();
    Ok((json, text, PyBytes::new(py, &bytes), epochs))
}
