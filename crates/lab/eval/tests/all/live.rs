//! Settings of the live tick for recordings.

use joulebus_config::Config;
use joulebus_settings::{FleetSettings, Intake};

/// The shipped config for one robot, without platforms, and with no limit on the jumps of stamps,
/// so that no gap of a recording is refused.
pub(crate) fn settings() -> FleetSettings {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../configs/fleet.toml");
    let shipped = Config::load(file).expect("the shipped config is valid");
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
