//! Opening a model: a file of joulebus, or a built-in one.

use joulebus_config::{builtin_model, builtin_models};
use joulebus_predictor::{MAX_MODEL_BYTES, Model, Network};

use crate::abi::types::joulebus_error;
use crate::failure::Failure;

/// Prefix of the names of built-in models, as in the config.
const BUILTIN: &str = "builtin:";

/// The network of a `.safetensors` file, or of `builtin:NAME`.
pub(crate) fn open(model: &str) -> Result<Model, Failure> {
    let refused = |text: String| Failure::new(joulebus_error::Model, text);
    let network = if let Some(name) = model.strip_prefix(BUILTIN) {
        let Some((_, bytes)) = builtin_model(name) else {
            let allowed: Vec<&str> = builtin_models().collect();
            return Err(refused(format!(
                "there is no built-in model {name}, allowed are {}",
                allowed.join(", ")
            )));
        };
        Network::from_safetensors(bytes)
    } else {
        let bytes = joulebus_files::read(model.as_ref(), MAX_MODEL_BYTES as u64)
            .map_err(|error| refused(format!("cannot read {model}: {error}")))?;
        Network::from_safetensors(&bytes)
    };
    let network = network.map_err(|error| refused(format!("model {model} is refused: {error}")))?;
    Ok(Model::Network(network))
}
