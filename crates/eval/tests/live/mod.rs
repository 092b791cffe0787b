//! The settings of the live tick that recordings are judged with.

use joulebus_config::Config;
use joulebus_settings::{FleetSettings, Intake};

/// Those of the shipped config for one robot, without platforms; but no gap in a recording is too
/// long for its stamps to be taken.
pub(crate) fn settings() -> FleetSettings {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/fleet.toml");
    let shipped = Config::load(file).expect("the config that ships is sound");
    let shipped = shipped.settings();
    FleetSettings {
        capacity: 1,
        intake: Intake {
            max_jump_ns: 3_600_000_000_000,
            leave_after_ns: 3_600_000_000_000,
            ..shipped.intake
        },
        platforms: Vec::new(),
        ..shipped.clone()
    }
}
