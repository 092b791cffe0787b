//! Training on rows of features: what `Predictor.fit` calls.

use joulebus_dataset::rows::{Dataset, Row};
use joulebus_predictor::{FeatureSet, INPUTS};
use joulebus_train::{Epoch, TrainError, TrainSettings, Training};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::array::{Numbers, shape_error};

/// Number, training loss, validation loss, and whether it is the best so far.
pub(crate) type EpochRow = (u32, f64, f64, bool);

/// Trains a network by the paper's recipe on rows in their order: the first `parts[0]` train, the
/// next `parts[1]` end the training, the rest are held out. Returns the model file's bytes and the
/// epochs. `progress`, if given, is called with each epoch. An exception of it, or Ctrl-C, ends the
/// training after the current epoch.
#[pyfunction]
#[pyo3(signature = (features, power_w, parts, *, name, feature_set, seed, max_epochs, patience, progress = None))]
#[allow(clippy::too_many_arguments, reason = "keywords of one call in Python")]
pub(crate) fn train_rows<'py>(
    py: Python<'py>,
    features: &Bound<'py, PyAny>,
    power_w: &Bound<'py, PyAny>,
    parts: (usize, usize),
    name: &str,
    feature_set: &str,
    seed: u64,
    max_epochs: u32,
    patience: u32,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyBytes>, Vec<EpochRow>)> {
    let Some(set) = FeatureSet::from_name(feature_set) else {
        let allowed = FeatureSet::ALL.map(FeatureSet::name).join(", ");
        return Err(PyValueError::new_err(format!(
            "feature_set is {feature_set}, allowed: {allowed}"
        )));
    };
    let mut settings = TrainSettings::new(name, "rows given in Python", set, seed);
    (settings.max_epochs, settings.patience) = (max_epochs, patience);
    let dataset = dataset(features, power_w, parts, set)?;
    let mut training = py.detach(|| Training::new(&dataset, &settings, 0)).map_err(refused)?;
    while !training.is_done() {
        let epoch = py.detach(|| training.epoch()).map_err(refused)?;
        py.check_signals()?;
        if let Some(progress) = progress {
            progress.call1(epoch_row(epoch))?;
        }
    }
    let trained = py.detach(|| training.finish()).map_err(refused)?;
    let bytes = trained
        .network
        .to_safetensors()
        .map_err(|error| PyValueError::new_err(error.to_string()))?;
    let epochs = trained.epochs.into_iter().map(epoch_row).collect();
    Ok((PyBytes::new(py, &bytes), epochs))
}

fn dataset(
    features: &Bound<'_, PyAny>,
    power_w: &Bound<'_, PyAny>,
    (training, validation): (usize, usize),
    set: FeatureSet,
) -> PyResult<Dataset> {
    let (rows, targets) =
        (Numbers::read("features", features)?, Numbers::read("power_w", power_w)?);
    let width = match *rows.shape {
        [_, width] if set.end() <= width && width <= INPUTS => width,
        _ => {
            let allowed = format!("(rows, {}) for {}", set.end(), set.name());
            return Err(shape_error("features", &rows.shape, &allowed));
        }
    };
    let count = rows.shape[0];
    if *targets.shape != [count] {
        let allowed = format!("({count},), one reading for each row of features");
        return Err(shape_error("power_w", &targets.shape, &allowed));
    }
    let row = |(values, target_w): (&[f32], &f32)| {
        let mut features = [f32::NAN; INPUTS];
        features[..width].copy_from_slice(values);
        let target_w = *target_w;
        Row::new(features, target_w)
    };
    let mut rows: Vec<Row> =
        rows.values.chunks_exact(width).zip(&targets.values).map(row).collect();
    let held_out = rows.split_off((training + validation).min(count));
    let validation = rows.split_off(training.min(rows.len()));
    Ok(Dataset {
        training: rows,
        validation,
        held_out,
        description: format!("{count} rows given in Python"),
        period_s: 0.0,
    })
}

pub(crate) fn refused(error: TrainError) -> PyErr {
    PyValueError::new_err(error.to_string())
}

pub(crate) fn epoch_row(epoch: Epoch) -> EpochRow {
    (epoch.number, epoch.training_loss, epoch.validation_loss, epoch.best)
}
