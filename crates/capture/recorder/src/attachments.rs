//! Attachments that make a capture replayable on its own: configs, models and build.

use joulebus_bus::clock;
use joulebus_capture_format::{Attachments, Clock};
use joulebus_config::{BundleError, Config};

/// Errors of assembling the files.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum AttachError {
    /// A model could not be read, or the config could not be bundled.
    #[error(transparent)]
    Bundle(#[from] BundleError),
    /// Two fleets of the same name: their channels would be indistinguishable.
    #[error("two configs of a fleet named {fleet:?}. Give them different names to record both")]
    TwoOfAName { fleet: String },
}

/// The offset between this host's clocks now.
#[must_use]
pub fn host_clock() -> Clock {
    Clock::between(clock::unix_ns(), clock::monotonic_ns())
}

/// The configs with all files that they refer to, and a description of this build. `clock` is
/// stored in the metadata.
///
/// # Errors
/// [`AttachError`].
pub fn attach(configs: &[Config], clock: Clock) -> Result<Attachments, AttachError> {
    let boot_id = clock::boot_id().unwrap_or_default();
    let mut attachments = Attachments::begun(clock::unix_ns(), clock, boot_id);
    for config in configs {
        let fleet = config.fleet();
        if attachments.config(fleet).is_some() {
            return Err(AttachError::TwoOfAName { fleet: fleet.to_owned() });
        }
        let bundle = config.bundle()?;
        attachments.add_fleet(fleet, bundle.toml, bundle.files);
    }
    attachments.add_build();
    let fleets: Vec<&str> = configs.iter().map(Config::fleet).collect();
    attachments.describe("fleets", fleets.join(" "));
    Ok(attachments)
}
