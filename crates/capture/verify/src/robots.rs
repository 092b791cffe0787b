//! Compares rows of single robots, which a recorder repeats for plots, with the frames before them.

use std::collections::HashMap;
use std::hash::{BuildHasher as _, RandomState};

use joulebus_capture_format::Message;

/// Frames of a channel without rows of single robots after which none are expected.
const MAX_FRAMES_WITHOUT: u32 = 2;

/// The rows of the newest frame of each channel, by the channel's name.
#[derive(Debug, Default)]
pub(super) struct RobotRows {
    channels: HashMap<&'static str, NewestRows>,
    hasher: RandomState,
}

/// The rows of the newest frame of a channel.
#[derive(Debug, Default)]
struct NewestRows {
    hashes: HashMap<u32, u64>,
    tick: u64,
    frames_without: u32,
}

impl RobotRows {
    /// Takes the next message. If it is a robot's row that its frame does not have, returns the
    /// name of the channel and the number of the frame.
    pub(super) fn take(&mut self, message: &Message) -> Option<(&'static str, u64)> {
        let kind = message.kind()?;
        if let Some(robot) = message.robot() {
            let newest = self.channels.entry(kind.name()).or_default();
            newest.frames_without = 0;
            let is_other = |hash: &u64| *hash != self.hasher.hash_one(message);
            // Without its frame it cannot be compared: then the channel is not recorded.
            let has_frame = !newest.hashes.is_empty();
            let differs = newest.hashes.get(&robot).map_or(has_frame, is_other);
            return differs.then_some((kind.name(), newest.tick));
        }
        if kind.has_robots() {
            let newest = self.channels.entry(kind.name()).or_default();
            newest.hashes.clear();
            newest.tick = message.order().map_or(0, |order| order.number);
            if newest.frames_without < MAX_FRAMES_WITHOUT {
                newest.frames_without += 1;
                message.each_robot(|row| {
                    if let Some(robot) = row.robot() {
                        newest.hashes.insert(robot, self.hasher.hash_one(&row));
                    }
                });
            }
        }
        None
    }
}
