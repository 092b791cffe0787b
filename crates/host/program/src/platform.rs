//! The platform named by a user.

use joulebus_settings::{FleetSettings, Platform};

use crate::exit::UsageError;

/// The platform of that name.
///
/// # Errors
/// The config has no such platform.
pub fn platform<'a>(settings: &'a FleetSettings, name: &str) -> Result<&'a Platform, UsageError> {
    let mut platforms = settings.platforms.iter();
    platforms.find(|platform| platform.name == name).ok_or_else(|| {
        let known = names(&settings.platforms);
        UsageError(format!("{name:?} is not a platform of the config. Its platforms are: {known}"))
    })
}

/// All names, for messages.
#[must_use]
pub fn names(platforms: &[Platform]) -> String {
    let names: Vec<&str> = platforms.iter().map(|platform| platform.name.as_str()).collect();
    names.join(", ")
}
