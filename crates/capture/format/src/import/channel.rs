//! A channel of a recording.

use joulebus_ros_messages::{RosError, RosType};

#[derive(Debug, Clone)]
pub(super) struct Channel {
    pub(super) topic: String,
    pub(super) type_name: String,
    pub(super) encoding: String,
    pub(super) kind: Result<RosType, RosError>,
    pub(super) messages: u64,
}

impl Channel {
    /// True if both are of one topic of a recording.
    fn is_of(&self, other: &Self) -> bool {
        (&self.topic, &self.type_name, &self.encoding)
            == (&other.topic, &other.type_name, &other.encoding)
            && self.kind == other.kind
    }
}

/// Adds the channels of a recording's next file. A topic may have several: of a publisher that was
/// started again, or of recordings that were merged.
pub(super) fn join(channels: &mut Vec<Channel>, of_next_file: Vec<Channel>) {
    for channel in of_next_file {
        match channels.iter_mut().find(|known| known.is_of(&channel)) {
            Some(known) => known.messages += channel.messages,
            None => channels.push(channel),
        }
    }
}
