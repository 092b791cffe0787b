//! Errors of the settings check.

/// Reason that settings were refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum SettingsError {
    /// A number is out of bounds.
    #[error("{what} is {found}, allowed is {}", words(*.min, *.max))]
    OutOfRange {
        what: String,
        found: f64,
        min: f64,
        /// Upper bound. Infinite if there is none.
        max: f64,
    },
    /// The number of models differs from the number of platforms.
    #[error("{platforms} platforms but {models} models: each platform needs exactly one")]
    Models { platforms: usize, models: usize },
    /// A robot id belongs to two platforms.
    #[error(
        "robot {robot} belongs to platform {first} and to platform {second}: take it out of one of them"
    )]
    SharedRobot { robot: u32, first: String, second: String },
}

/// A range of numbers as text.
fn words(min: f64, max: f64) -> String {
    if max == f64::INFINITY { format!("at least {min}") } else { format!("{min} to {max}") }
}
