#![doc = include_str!("../README.md")]
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
#[allow(missing_docs)] // The messages name the fields.
pub enum ModelsError {
    /// The file cannot be read.
    #[error("model {path} of platform {platform}: {source}")]
    Read { platform: String, path: PathBuf, source: std::io::Error },
    /// The file is of another program.
    #[error("model {path} of platform {platform} is {kind}")]
    Foreign { platform: String, path: PathBuf, kind: String },
    /// The model is refused.
    #[error("model {model} of platform {platform} is refused: {source}")]
    Refused { platform: String, model: String, source: Box<ModelError> },
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
        ModelSource::Attached(name, bytes) => {
            (name.to_string(), Network::from_safetensors(bytes).map(Model::Network))
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
