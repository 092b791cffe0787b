//! Loads the models that the config of a fleet names: files, built-in models, persistence.
//!
//! The worker does, and so does every planner that computes for itself.
//!
//! ```
//! use joulebus_predictor::Model;
//!
//! let text = "[fleet]\nname = \"lab\"\n[[platform]]\nfile = \"builtin:gternal\"\nrobots = [7]\n";
//! let config = joulebus_config::Config::parse(text, std::path::Path::new("."))?;
//! let models = joulebus_models::load_models(&config)?;
//! assert!(matches!(models[..], [Model::Network(_)]));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! **To know.** [`load_models`] returns one [`Model`] for each platform, in the order of the
//! settings. A [`ModelSource`] is the config's entry for a platform's model.
//!
//! **Units.** Models forecast W.
//!
//! **Errors** name the platform and its file ([`ModelsError`]): it cannot be read, or its contents
//! are refused. A file of another program is recognised, with the command that converts it.
//!
//! **In the book**: [models that ship][1], [train, compare and export models][2], [config, every
//! key][3].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/reference/models.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/how-to/models.md
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/reference/config.md
#![forbid(unsafe_code)]

use std::path::PathBuf;

use joulebus_config::{Config, ModelSource};
use joulebus_files::foreign;
use joulebus_predictor::{MAX_MODEL_BYTES, Model, ModelError, Network, Persistence, ResidualStats};

/// 95 % quantile of the standard normal distribution: initial interval of a model without residual
/// quantiles, before it adapts.
const NORMAL_95: f32 = 1.645;

/// Errors of loading a platform's model.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ModelsError {
    /// The file cannot be read.
    #[error("model {path} of platform {platform}: {source}")]
    Read {
        /// The platform.
        platform: String,
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        source: std::io::Error,
    },
    /// The file is of another program.
    #[error("model {path} of platform {platform} is {kind}")]
    Foreign {
        /// The platform.
        platform: String,
        /// The file.
        path: PathBuf,
        /// The kind of file, with its conversion.
        kind: String,
    },
    /// The model is refused.
    #[error("model {model} of platform {platform} is refused: {source}")]
    Refused {
        /// The platform.
        platform: String,
        /// Its file or name.
        model: String,
        /// The reason.
        source: Box<ModelError>,
    },
}

/// The models of all platforms, in the order of the settings.
///
/// # Errors
/// The first model that cannot be read or is refused.
pub fn load_models(config: &Config) -> Result<Vec<Model>, ModelsError> {
    let platforms = config.settings().platforms.iter();
    platforms.zip(config.models()).map(|(platform, source)| load(&platform.name, source)).collect()
}

fn load(platform: &str, source: &ModelSource) -> Result<Model, ModelsError> {
    let (name, loaded) = match source {
        ModelSource::File(path) => {
            let read = joulebus_files::read(path, MAX_MODEL_BYTES as u64);
            let bytes = read.map_err(|source| ModelsError::Read {
                platform: platform.to_owned(),
                path: path.clone(),
                source,
            })?;
            let network = Network::from_safetensors(&bytes).map(Model::Network);
            let kind = foreign::of_model(path, &bytes).filter(|_| network.is_err());
            if let Some(kind) = kind {
                let (platform, path) = (platform.to_owned(), path.clone());
                return Err(ModelsError::Foreign { platform, path, kind });
            }
            (path.display().to_string(), network)
        }
        ModelSource::Builtin(name, bytes) => {
            let network = Network::from_safetensors(bytes).map(Model::Network);
            ((*name).to_owned(), network)
        }
        ModelSource::Persistence { residual_std_w } => {
            let end_w = NORMAL_95 * residual_std_w;
            let residual = ResidualStats { std_w: *residual_std_w, q05_w: -end_w, q95_w: end_w };
            ("persistence".to_owned(), Persistence::new(residual).map(Model::Persistence))
        }
    };
    loaded.map_err(|source| ModelsError::Refused {
        platform: platform.to_owned(),
        model: name,
        source: Box::new(source),
    })
}
