//! The kinds of messages of all channels.

use joulebus_wire::{
    Acknowledgements, Budgets, Channel, Diagnostics, Forecasts, Outlooks, PlanStates, Queries, Row,
    Samples, State, Ticks, records,
};

use super::descriptors;
use super::frame::{Frame, RobotRow};
use super::message::{Message, MessageKind};
use super::query::Query;

/// Is called with every channel of [`MessageKind::ALL`].
pub trait ForEachChannel {
    /// Takes a channel. `has_robots`, if captures may have its rows as messages of single robots.
    fn channel<C: Channel>(&mut self, has_robots: bool);
}

macro_rules! channels {
    ($([$($robots:ident)?] $channel:ident,)*) => {
        impl MessageKind {
            /// All kinds of the channels in [`joulebus_wire`]. First those with one topic for the
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
    [] Outlooks,
    [] Ticks,
    [] State,
    [] Queries,
    [] Acknowledgements,
}

impl MessageKind {
    /// The kind of a channel's frames.
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

    /// The kind of single robots' rows of a channel.
    #[must_use]
    pub const fn of_robot<C: Channel>() -> Self {
        Self {
            message: <C::Row as Row>::LAYOUT.name,
            is_of_robot: true,
            decode: RobotRow::<C>::decode,
            ..Self::of::<C>()
        }
    }
}

impl Message {
    /// Calls `take` with the messages of a frame: itself, or each record of a question.
    pub fn each_of_frame<C: Channel>(
        header: &C::Header,
        rows: &[C::Row],
        mut take: impl FnMut(Self),
    ) {
        if MessageKind::of::<C>() == MessageKind::of::<Queries>() {
            let words = bytemuck::cast_slice(rows);
            records(words).for_each(|record| take(Query::of_record(record).into()));
        } else {
            take(Self::of::<C>(*header, rows.to_vec()));
        }
    }
}
