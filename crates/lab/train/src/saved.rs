//! Checkpoints of a training run.

use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors, serialize};
use thiserror::Error;

use joulebus_dataset::rows::Dataset;

use super::{Epoch, TrainError, TrainSettings, Training};

const FORMAT: &str = "joulebus-training-1";

/// Errors of resuming a run.
#[derive(Debug, Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum ResumeError {
    #[error(transparent)]
    Train(#[from] TrainError),
    #[error("no saved run: {0}")]
    Format(String),
    #[error("the saved run has another {what}: {found}, expected {expected}. Start a new run")]
    Differs { what: &'static str, found: String, expected: String },
}

impl Training {
    /// The run so far, a safetensors file. With [`Training::resume`] it continues to the same
    /// result.
    pub fn saved(&self) -> Vec<u8> {
        let tensors = [
            ("weights", &self.weights.values),
            ("best", &self.best.values),
            ("first_moments", &self.adam.first),
            ("second_moments", &self.adam.second),
        ]
        .map(|(name, values)| (name, bytes(values)));
        let views = tensors.iter().map(|(name, bytes)| {
            let view = TensorView::new(Dtype::F32, vec![bytes.len() / 4], bytes)
                .expect("four bytes per number of the shape");
            (*name, view)
        });
        let metadata = [
            ("format".to_owned(), FORMAT.to_owned()),
            ("settings".to_owned(), json(&self.settings)),
            ("data_sha256".to_owned(), self.dataset.sha256(self.settings.feature_set)),
            ("epochs".to_owned(), json(&self.epochs)),
            ("steps".to_owned(), self.adam.steps.to_string()),
        ];
        let metadata = metadata.into_iter().collect();
        serialize(views, Some(metadata)).expect("names are distinct and sizes match")
    }

    /// Resumes a saved run on `threads` threads, as in [`Training::new`]. The number of epochs may
    /// be larger than before. Nothing else may differ.
    ///
    /// # Errors
    /// [`ResumeError`]: corrupt bytes, or another dataset or other settings.
    pub fn resume(
        dataset: &Dataset,
        settings: &TrainSettings,
        threads: usize,
        saved: &[u8],
    ) -> Result<Self, ResumeError> {
        let format = |error: &dyn std::fmt::Display| ResumeError::Format(error.to_string());
        let (_, header) = SafeTensors::read_metadata(saved).map_err(|error| format(&error))?;
        let metadata = header.metadata().clone().unwrap_or_default();
        let field = |name: &str| {
            let missing = || ResumeError::Format(format!("`{name}` is missing"));
            metadata.get(name).cloned().ok_or_else(missing)
        };
        same("format", field("format")?, FORMAT.to_owned())?;
        let mut training = Self::new(dataset, settings, threads)?;
        let before: TrainSettings =
            serde_json::from_str(&field("settings")?).map_err(|error| format(&error))?;
        let comparable = TrainSettings {
            max_epochs: settings.max_epochs,
            patience: settings.patience,
            ..before
        };
        same("recipe", json(&comparable), json(settings))?;
        same("data hash", field("data_sha256")?, training.dataset.sha256(settings.feature_set))?;
        let epochs: Vec<Epoch> =
            serde_json::from_str(&field("epochs")?).map_err(|error| format(&error))?;
        let tensors = SafeTensors::deserialize(saved).map_err(|error| format(&error))?;
        let read = |name: &str| -> Result<Vec<f32>, ResumeError> {
            let view = tensors.tensor(name).map_err(|error| format(&error))?;
            let values = numbers(view.data());
            let expected = training.weights.values.len();
            if view.dtype() != Dtype::F32 || values.len() != expected {
                let found = (view.dtype(), values.len());
                return Err(ResumeError::Format(format!(
                    "`{name}` has {found:?}, expected {expected} of F32"
                )));
            }
            if let Some(at) = values.iter().position(|value| !value.is_finite()) {
                let found = values[at];
                return Err(ResumeError::Format(format!("`{name}` has {found} at {at}")));
            }
            Ok(values)
        };
        let (weights, best) = (read("weights")?, read("best")?);
        let moments = (read("first_moments")?, read("second_moments")?);
        training.adam.steps = field("steps")?.parse().map_err(|error| format(&error))?;
        (training.adam.first, training.adam.second) = moments;
        training.best.values = best;
        training.set_weights(&weights);
        training.epochs = epochs;
        Ok(training)
    }
}

fn same(what: &'static str, found: String, expected: String) -> Result<(), ResumeError> {
    if found == expected {
        return Ok(());
    }
    Err(ResumeError::Differs { what, found, expected })
}

/// Numbers and names always serialise.
fn json(value: &impl serde::Serialize) -> String {
    serde_json::to_string(value).unwrap_or_default()
}

fn bytes(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

fn numbers(bytes: &[u8]) -> Vec<f32> {
    let fours = bytes.as_chunks::<4>().0;
    fours.iter().map(|four| f32::from_le_bytes(*four)).collect()
}
