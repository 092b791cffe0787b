//! A recipe: how a network is trained, and which rows train it.

use joulebus_dataset::split::Split;
use serde::Deserialize;

use super::TrainSettings;

/// Settings of the training and of the split. The default is the paper's.
/// `configs/recipes/paper.toml` explains every key.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Recipe {
    /// The training.
    pub training: TrainSettings,
    /// The parts of the rows.
    pub split: Split,
}

/// Reason that a recipe is refused, with its position.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct RecipeError(String);

impl Recipe {
    /// The recipe of a TOML file's text.
    ///
    /// # Errors
    /// [`RecipeError`]: an unknown key, or a value of another kind.
    pub fn parse(text: &str) -> Result<Self, RecipeError> {
        toml::from_str(text).map_err(|error| RecipeError(error.to_string()))
    }

    /// Whether a TOML file's text states the features. The default is for recordings with
    /// velocities.
    pub fn states_features(text: &str) -> bool {
        let table: Option<toml::Table> = toml::from_str(text).ok();
        let training = table.as_ref().and_then(|table| table.get("training"));
        training.is_some_and(|training| training.get("feature_set").is_some())
    }
}
