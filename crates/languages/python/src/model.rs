//! Opening a model: a file of joulebus, or a built-in one.

use std::path::Path;

use joulebus_config::{builtin_model, builtin_models};
use joulebus_files::foreign;
use joulebus_predictor::{MAX_MODEL_BYTES, Network};
use pyo3::exceptions::PyValueError;
use pyo3::{PyErr, PyResult};

use crate::error::{ModelError, of_file};

/// Prefix of the names of built-in models, as in the config.
const BUILTIN: &str = "builtin:";

/// The network of a file, or of `builtin:NAME`.
pub(crate) fn open(model: &Path) -> PyResult<Network> {
    if let Some(name) = model.to_str().and_then(|name| name.strip_prefix(BUILTIN)) {
        return builtin(name);
    }
    let bytes = joulebus_files::read(model, MAX_MODEL_BYTES as u64)
        .map_err(|error| of_file(model, &error))?;
    Network::from_safetensors(&bytes).map_err(|error| {
        let name = model.display();
        ModelError::new_err(match foreign::of_model(model, &bytes) {
            Some(kind) => format!("{name} is {kind}"),
            None => format!("{name}: {error}"),
        })
    })
}

fn builtin(name: &str) -> PyResult<Network> {
    let Some((_, bytes)) = builtin_model(name) else {
        let allowed: Vec<&str> = builtin_models().collect();
        return Err(ModelError::new_err(format!(
            "there is no built-in model {name}, allowed are {}",
            allowed.join(", ")
        )));
    };
    of_bytes(bytes)
}

/// The network in the bytes of a model file.
pub(crate) fn of_bytes(bytes: &[u8]) -> PyResult<Network> {
    Network::from_safetensors(bytes).map_err(|error| ModelError::new_err(error.to_string()))
}

/// The time between two steps at which a network forecasts, s. `argument` is what can state it.
pub(crate) fn period_s(network: &Network, argument: &str) -> PyResult<f32> {
    network.card().period_s().ok_or_else(|| without_period(argument))
}

/// Refuses a model that does not state its period.
pub(crate) fn without_period(argument: &str) -> PyErr {
    PyValueError::new_err(format!(
        "the model does not state its period: give {argument}, the time between two steps in s \
         (0.033 in the Robotarium)"
    ))
}
