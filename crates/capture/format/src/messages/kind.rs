//! Kinds of messages.

use std::fmt;
use std::hash::{Hash, Hasher};

use joulebus_wire::{
    Budgets, Channel, Diagnostics, Flow, Forecasts, FrameRows, PlanStates, Queries, Row, Samples,
    State, Ticks,
};

use super::{DecodeError, Frame, Message, Query, RobotRow, descriptors};

/// Kind of the messages of a topic: frames of a channel, single robots' rows of them, or questions
/// with their answers.
#[derive(Clone, Copy)]
pub struct MessageKind {
    /// Name of the channel's service.
    name: &'static str,
    /// Name of the message, without its package: unique.
    message: &'static str,
    is_of_robot: bool,
    flow: Flow,
    rows: FrameRows,
    decode: fn(&[u8]) -> Result<Message, DecodeError>,
    descriptors: fn(&str) -> Vec<u8>,
}

/// Is called with every channel of [`MessageKind::ALL`].
pub trait ForEachChannel {
    /// Takes a channel; `has_robots`, if captures may have its rows as messages of single robots.
    fn channel<C: Channel>(&mut self, has_robots: bool);
}

macro_rules! channels {
    ($([$($robots:ident)?] $channel:ident,)*) => {
        impl MessageKind {
            /// All kinds of the channels in [`joulebus_wire`]; first those with one topic for the
            /// whole fleet.
            pub const ALL: &'static [Self] = &[
                $(Self::of::<$channel>(),)*
                $($(Self::of_robot::<$robots>(),)?)*
            ];

            /// Kinds with one topic for the whole fleet.
            pub const OF_FLEET: &'static [Self] = &[$(Self::of::<$channel>()),*];

            /// Calls `each` with the channels of [`MessageKind::OF_FLEET`], in that order.
            pub fn each_channel(each: &mut impl ForEachChannel) {
                $(each.channel::<$channel>(!stringify!($($robots)?).is_empty());)*
            }
        }
    };
}

// In brackets again where captures may have the rows as messages of single robots.
channels! {
    [Samples] Samples,
    [Forecasts] Forecasts,
    [Diagnostics] Diagnostics,
    [Budgets] Budgets,
    [] PlanStates,
    [] Ticks,
    [] State,
    [] Queries,
}

impl MessageKind {
    /// That of a channel's frames.
    #[must_use]
    pub const fn of<C: Channel>() -> Self {
        let kind = Self {
            name: C::SERVICE.name(),
            message: C::MESSAGE,
            is_of_robot: false,
            flow: C::FLOW,
            rows: C::ROWS,
            decode: Frame::<C>::decode,
            descriptors: descriptors::files_of::<C>,
        };
        match C::MESSAGE.as_bytes() {
            // Each record in a frame of these is a message.
            b"Queries" => Self {
                message: "Query",
                decode: Query::decode,
                descriptors: descriptors::files_of_ours,
                ..kind
            },
            _ => kind,
        }
    }

    /// That of single robots' rows of a channel.
    #[must_use]
    pub const fn of_robot<C: Channel>() -> Self {
        Self {
            message: <C::Row as Row>::LAYOUT.name,
            is_of_robot: true,
            decode: RobotRow::<C>::decode,
            ..Self::of::<C>()
        }
    }

    /// Who sends on the channel and who reads.
    #[must_use]
    pub const fn flow(self) -> Flow {
        self.flow
    }

    /// What the rows of the channel's frames are.
    #[must_use]
    pub const fn rows(self) -> FrameRows {
        self.rows
    }

    /// The name of the service.
    #[must_use]
    pub const fn name(self) -> &'static str {
        self.name
    }

    /// The name of the schema.
    #[must_use]
    pub fn schema(self) -> String {
        format!("joulebus.{}", self.message)
    }

    /// The protobuf file set that describes the messages: the schema's data.
    #[must_use]
    pub fn descriptors(self) -> Vec<u8> {
        (self.descriptors)(self.message)
    }

    /// Whether its schema has this name.
    #[must_use]
    pub fn is_schema(self, name: &str) -> bool {
        name.strip_prefix("joulebus.") == Some(self.message)
    }

    /// The channel's topic; `robot` is used only by kinds of single robots.
    #[must_use]
    pub fn topic(self, fleet: &str, robot: u32) -> String {
        if self.is_of_robot {
            format!("joulebus/{fleet}/robot/{robot}/{}", self.message_name())
        } else {
            format!("joulebus/{fleet}/{}", self.name)
        }
    }

    /// The name of the message in small letters: `plan_state`.
    #[must_use]
    pub fn message_name(self) -> String {
        let mut name = String::new();
        for letter in self.message.chars() {
            if letter.is_ascii_uppercase() && !name.is_empty() {
                name.push('_');
            }
            name.push(letter.to_ascii_lowercase());
        }
        name
    }

    pub(super) fn decode(self, data: &[u8]) -> Result<Message, DecodeError> {
        (self.decode)(data)
    }
}

impl PartialEq for MessageKind {
    fn eq(&self, other: &Self) -> bool {
        self.message == other.message
    }
}

impl Eq for MessageKind {}

impl Hash for MessageKind {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.message.hash(state);
    }
}

impl fmt::Debug for MessageKind {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(self.message)
    }
}
