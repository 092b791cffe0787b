//! Errors of the settings check.

/// Reason that settings were refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SettingsError {
    /// A number is out of bounds.
    #[error("{what} is {found}, allowed is {}", words(*.min, *.max))]
    OutOfRange {
        /// Name of the setting.
        what: String,
        /// Its value.
        found: f64,
        /// Lower bound.
        min: f64,
        /// Upper bound. Infinite if there is none.
        max: f64,
    },
    /// The number of models differs from the number of platforms.
    #[error("{platforms} platforms but {models} models: each platform needs exactly one")]
    Models {
        /// Platforms in the settings.
        platforms: usize,
        /// Models given.
        models: usize,
    },
    /// A robot id belongs to two platforms.
    #[error(
        "robot {robot} belongs to platform {first} and to platform {second}: take it out of one of them"
    )]
    SharedRobot {
        /// The robot.
        robot: u32,
        /// The first platform that lists it.
        first: String,
        /// The second platform that lists it.
        second: String,
    },
}

/// A range of numbers as text.
fn words(min: f64, max: f64) -> String {
    if max == f64::INFINITY { format!("at least {min}") } else { format!("{min} to {max}") }
}
