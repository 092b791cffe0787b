//! Interpretation of a recording, by a mapping file.

use std::path::Path;

use anyhow::Context as _;
use joulebus_capture_format::import::{CurrentSign, Mapping};
use joulebus_program::exit::UsageError;

use crate::recordings::Sign;

/// Maximum size of a mapping, bytes.
const MAX_MAPPING_BYTES: u64 = 4 << 20;

/// The mapping of a file, or that of bags without one, with the sign of the current that an option
/// states.
pub(super) fn mapping(file: Option<&Path>, current: Option<Sign>) -> anyhow::Result<Mapping> {
    let mut mapping = match file {
        None => Mapping::default(),
        Some(path) => {
            let named = || path.display().to_string();
            let text =
                joulebus_files::read_to_string(path, MAX_MAPPING_BYTES).with_context(named)?;
            let parsed = text.parse::<Mapping>();
            parsed.map_err(|error| UsageError(format!("{}: {error}", named())))?
        }
    };
    if let Some(sign) = current {
        mapping.set_current(match sign {
            Sign::DischargeNegative => CurrentSign::DischargeNegative,
            Sign::DischargePositive => CurrentSign::DischargePositive,
        });
    }
    mapping.check().map_err(|error| UsageError(error.to_string()))?;
    Ok(mapping)
}
