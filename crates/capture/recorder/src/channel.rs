//! Channels that are recorded.

use joulebus_bus::{Bus, Limits, OpenError, Reader, ReceiveError};
use joulebus_capture_format::{Message, MessageKind};
use joulebus_wire::{Channel, ForEachChannel, each_channel};

pub(crate) type Open = fn(&Bus, &Limits) -> Result<Box<dyn Intake>, OpenError>;

/// A channel that is recorded.
#[derive(Debug, Clone, Copy)]
pub struct RecordedChannel {
    /// Kind of its messages.
    pub kind: MessageKind,
    pub(crate) open: Open,
}

impl RecordedChannel {
    /// A channel, also one that is declared elsewhere.
    #[must_use]
    pub const fn of<C: Channel>() -> Self {
        Self {
            kind: MessageKind::of::<C>(),
            open: |bus, limits| Ok(Box::new(bus.reader::<C>(limits)?)),
        }
    }

    /// All channels of a fleet, causes before effects.
    #[must_use]
    pub fn all() -> Vec<Self> {
        struct All(Vec<RecordedChannel>);
        impl ForEachChannel for All {
            fn channel<C: Channel>(&mut self) {
                self.0.push(RecordedChannel::of::<C>());
            }
        }
        let mut all = All(Vec::new());
        each_channel(&mut all);
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
