//! A config with all files that it refers to, independent of their location.

use std::path::PathBuf;

use crate::files::MAX_BYTES;
use crate::values::quoted;
use crate::{Config, ModelSource};

/// A config as one text, and the files that it refers to by relative paths.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Bundle {
    /// The config: defaults and platforms resolved, each value with its origin.
    pub toml: String,
    /// Relative path and bytes of each file that it refers to.
    pub files: Vec<(String, Vec<u8>)>,
}

/// Errors of making a bundle.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum BundleError {
    /// A model could not be read.
    #[error("cannot read model {path:?}: {source}")]
    Model { path: PathBuf, source: std::io::Error },
}

impl Config {
    /// The config with its models, built-in ones included. It gives the same forecasts wherever it
    /// is read, but has no ledger file: a replay must not write into the fleet's own.
    ///
    /// # Errors
    /// A model that existed when the config was read can no longer be read.
    pub fn bundle(&self) -> Result<Bundle, BundleError> {
        let mut toml = String::new();
        let mut files = Vec::new();
        let mut sources = self.models().iter().enumerate();
        let mut of_platform = None;
        // `to_toml` writes each value on a separate line.
        for line in self.to_toml().lines() {
            if line == "[[platform]]" {
                of_platform = sources.next();
            }
            match (line.split(" = ").next(), of_platform) {
                (Some("checkpoint"), None) => toml += "checkpoint = \"\"",
                (Some("model"), Some((place, source))) => match model(source)? {
                    Some((name, bytes)) => {
                        let path = format!("models/{place}-{name}");
                        toml += &format!("model = {}", quoted(&path));
                        files.push((path, bytes));
                    }
                    None => toml += line,
                },
                _ => toml += line,
            }
            toml.push('\n');
        }
        Ok(Bundle { toml, files })
    }
}

/// Name and bytes of the model's file, if it has one.
fn model(source: &ModelSource) -> Result<Option<(String, Vec<u8>)>, BundleError> {
    match source {
        ModelSource::File(path) => {
            let bytes = joulebus_files::read(path, MAX_BYTES)
                .map_err(|source| BundleError::Model { path: path.clone(), source })?;
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            Ok(Some((name.into_owned(), bytes)))
        }
        ModelSource::Attached(path, bytes) => {
            let name = path.rsplit('/').next().unwrap_or_default();
            Ok(Some((name.to_owned(), bytes.to_vec())))
        }
        ModelSource::Builtin(name, bytes) => {
            Ok(Some((format!("{name}.safetensors"), bytes.to_vec())))
        }
        ModelSource::Persistence { .. } => Ok(None),
    }
}
