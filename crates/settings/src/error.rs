//! Why settings were refused.

/// Why settings were refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SettingsError {
    /// A number lies outside what is allowed.
    #[error("{what} is {found}, allowed is {}", words(*.min, *.max))]
    OutOfRange {
        /// Which setting.
        what: String,
        /// What it is.
        found: f64,
        /// Least value allowed.
        min: f64,
        /// Greatest value allowed; infinite where there is none.
        max: f64,
    },
    /// There is not one model for each platform.
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
        /// The platform that names it first.
        first: String,
        /// The platform that names it again.
        second: String,
    },
}

/// A range of numbers, in words.
fn words(min: f64, max: f64) -> String {
    if max == f64::INFINITY {
        format!("at least {min}")
    } else {
        format!("{min} to {max}")
    }
}
