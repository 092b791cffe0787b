//! Compares rows of single robots, which a recorder repeats for plots, with the frames before them.

use std::collections::HashMap;
use std::hash::{BuildHasher as _, RandomState};

use joulebus_capture_format::Message;

/// Frames of a channel with robots, but without rows of single ones, after which none are expected.
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
    /// By robot. `None` where no rows of single robots were expected.
    hashes: Option<HashMap<u32, u64>>,
    tick: u64,
    frames_without: u32,
}

impl RobotRows {
    /// Takes the next message. If it is a robot's row that its frame does not have, returns the
    /// name of the channel and the number of the frame. A row that comes before any frame has none
    /// to compare it with: a part of a recording may begin with it.
    pub(super) fn take(&mut self, message: &Message) -> Option<(&'static str, u64)> {
        let kind = message.kind()?;
        if let Some(robot) = message.robot() {
            let newest = self.channels.get_mut(kind.name())?;
            newest.frames_without = 0;
            let hash = newest.hashes.as_ref().and_then(|hashes| hashes.get(&robot));
            let is_same = hash.is_some_and(|hash| *hash == self.hasher.hash_one(message));
            return (!is_same).then_some((kind.name(), newest.tick));
        }
        if kind.has_robots() {
            let newest = self.channels.entry(kind.name()).or_default();
            newest.tick = message.order().map_or(0, |order| order.number);
            let mut hashes = newest.hashes.take().unwrap_or_default();
            if newest.frames_without < MAX_FRAMES_WITHOUT {
                hashes.clear();
                message.each_robot(|row| {
                    if let Some(robot) = row.robot() {
                        hashes.insert(robot, self.hasher.hash_one(&row));
                    }
                });
                newest.frames_without += u32::from(!hashes.is_empty());
                newest.hashes = Some(hashes);
            }
        }
        None
    }
}
