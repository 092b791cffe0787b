//! The keys of all kinds of files.

use joulebus_settings::bounds;

use crate::gateway_keys::{BRIDGE, LINK, WEBHOOKS};
use crate::key::Key;
use crate::keys::KEYS;

/// The keys of all files.
pub fn keys() -> impl Iterator<Item = &'static Key> {
    KEYS.iter().chain(BRIDGE).chain(LINK).chain(WEBHOOKS)
}

/// The key at `path`, if there is one. `*` stands for a name that is free.
pub(crate) fn find(path: &str) -> Option<&'static Key> {
    keys().find(|key| key.path == path || key.below(path) == Some(""))
}

/// Most tables that a list of the path may have. `None` if it is no list.
#[must_use]
pub fn list(path: &str) -> Option<usize> {
    Some(match path {
        "platform" => *bounds::PLATFORMS.end() as usize,
        "mqtt.read" | "mqtt.vda5050" | "mqtt.write" | "ros2.read" | "ros2.write" => 10_000,
        "webhook" => 16,
        "worker.take" => 256,
        _ => return None,
    })
}
