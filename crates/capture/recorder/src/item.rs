//! A message between the threads of a recording.

use std::sync::Arc;

use joulebus_capture_format::{Message, Times};

/// A message between the threads of a recording.
#[derive(Debug)]
pub(crate) struct Item {
    pub(crate) fleet: Arc<str>,
    pub(crate) times: Times,
    pub(crate) message: Message,
}

impl Item {
    pub(super) fn topic(&self) -> String {
        let kind = self.message.kind();
        kind.map_or_else(String::new, |kind| kind.topic(&self.fleet, 0))
    }

    pub(crate) fn bytes(&self) -> usize {
        size_of::<Self>() + self.message.memory()
    }
}
