//! The platform that a user names.

use joulebus_settings::{FleetSettings, Platform};

use crate::exit::UsageError;

/// The platform of that name.
///
/// # Errors
/// The config has none.
pub fn platform<'a>(settings: &'a FleetSettings, name: &str) -> Result<&'a Platform, UsageError> {
    let mut platforms = settings.platforms.iter();
    platforms
        .find(|platform| platform.name == name)
        .ok_or_else(|| {
            let known = names(&settings.platforms);
            UsageError(format!(
                "{name:?} is no platform of the config; those are: {known}"
            ))
        })
}

/// The names of all, for messages.
#[must_use]
pub fn names(platforms: &[Platform]) -> String {
    let names: Vec<&str> = platforms
        .iter()
        .map(|platform| platform.name.as_str())
        .collect();
    names.join(", ")
}
