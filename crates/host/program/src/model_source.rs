//! The model named by a user: a file, or a built-in one.

use std::borrow::Cow;
use std::path::Path;

use anyhow::{Context as _, anyhow};
use joulebus_config::{builtin_model, builtin_models};
use joulebus_files::foreign;
use joulebus_predictor::{MAX_MODEL_BYTES, Network};

use crate::exit::UsageError;

/// Prefix of built-in models, as in a config.
const BUILTIN: &str = "builtin:";

/// True if the path names a built-in model.
#[must_use]
pub fn is_builtin(path: &Path) -> bool {
    path.to_str().is_some_and(|name| name.starts_with(BUILTIN))
}

/// The network of a safetensors file, or of `builtin:NAME`.
///
/// # Errors
/// The file or model does not exist, or the file is refused.
pub fn load(path: &Path) -> anyhow::Result<Network> {
    let shown = path.display();
    let builtin = path.to_str().and_then(|name| name.strip_prefix(BUILTIN));
    let bytes: Cow<'_, [u8]> = match builtin {
        Some(name) => shipped(name)?.into(),
        None => joulebus_files::read(path, MAX_MODEL_BYTES as u64)
            .with_context(|| format!("cannot read the model {shown}"))?
            .into(),
    };
    Network::from_safetensors(&bytes).map_err(|error| match foreign::of_model(path, &bytes) {
        Some(kind) => anyhow!("the model {shown} is {kind}"),
        None => anyhow!(error).context(format!("the model {shown} is refused")),
    })
}

fn shipped(name: &str) -> anyhow::Result<&'static [u8]> {
    let (_, bytes) = builtin_model(name).ok_or_else(|| {
        let names: Vec<String> =
            builtin_models().map(|known| format!("{BUILTIN}{known}")).collect();
        let names = names.join(", ");
        anyhow!(UsageError(format!(
            "no model {BUILTIN}{name} ships with the program: there are {names}"
        )))
    })?;
    Ok(bytes)
}
