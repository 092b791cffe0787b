//! Channels that are recorded.

use joulebus_bus::{Bus, Limits, OpenError, Reader, ReceiveError};
use joulebus_capture_format::{ForEachChannel, Message, MessageKind};
use joulebus_wire::Channel;

pub(crate) type Open = fn(&Bus, &Limits) -> Result<Box<dyn Intake>, OpenError>;

/// A channel that is recorded.
#[derive(Debug, Clone, Copy)]
pub struct RecordedChannel {
    /// Kind of its messages.
    pub kind: MessageKind,
    /// Whether its rows are repeated as messages of single robots, where that is asked for.
    pub has_robots: bool,
    pub(crate) open: Open,
}

impl RecordedChannel {
    /// A channel, also one that is declared elsewhere.
    #[must_use]
    pub const fn of<C: Channel>(has_robots: bool) -> Self {
        Self {
            kind: MessageKind::of::<C>(),
            has_robots,
            open: |bus, limits| Ok(Box::new(bus.reader::<C>(limits)?)),
        }
    }

    /// All channels of a fleet, causes before effects.
    #[must_use]
    pub fn all() -> Vec<Self> {
        struct All(Vec<RecordedChannel>);
        impl ForEachChannel for All {
            fn channel<C: Channel>(&mut self, has_robots: bool) {
                self.0.push(RecordedChannel::of::<C>(has_robots));
            }
        }
        let mut all = All(Vec::new());
        MessageKind::each_channel(&mut all);
        all.0
    }
}

/// A port that is drained.
pub(crate) trait Intake {
    /// Receives all waiting frames.
    fn take_all(&mut self, batch: &mut Vec<Message>) -> Result<(), ReceiveError>;
}

impl<C: Channel> Intake for Reader<C> {
    fn take_all(&mut self, batch: &mut Vec<Message>) -> Result<(), ReceiveError> {
        Self::take_all(self, |header, rows| {
            Message::each_of_frame::<C>(header, rows, |message| batch.push(message));
        })
    }
}
