//! The kinds of messages of all channels.

use std::rc::Rc;

use joulebus_wire::{
    Channel, Flow, ForEachChannel, FrameRows, Queries, Row, TickHeader, each_channel, records,
};

use super::descriptors;
use super::frame::{Frame, RobotRow};
use super::message::{Message, MessageKind};
use super::query::Query;

/// Kinds of frames, and of single robots' rows.
#[derive(Default)]
struct Kinds {
    of_fleet: Vec<MessageKind>,
    of_robot: Vec<MessageKind>,
}

impl ForEachChannel for Kinds {
    fn channel<C: Channel>(&mut self) {
        let kind = MessageKind::of::<C>();
        self.of_fleet.push(kind);
        if kind.has_robots() {
            self.of_robot.push(MessageKind::of_robot::<C>());
        }
    }
}

thread_local! {
    /// Not of all threads: a child made by `fork` could find the lock taken for ever.
    static KINDS: Rc<Kinds> = {
        let mut kinds = Kinds::default();
        each_channel(&mut kinds);
        Rc::new(kinds)
    };
}

/// The kinds of a list in [`Kinds`].
fn listed(list: fn(&Kinds) -> &[MessageKind]) -> impl Iterator<Item = MessageKind> {
    let kinds = KINDS.with(Rc::clone);
    (0..list(&kinds).len()).map(move |at| list(&kinds)[at])
}

impl MessageKind {
    /// All kinds of the channels in [`joulebus_wire`]. First those with one topic for the whole
    /// fleet.
    pub fn all() -> impl Iterator<Item = Self> {
        Self::of_fleet().chain(listed(|kinds| &kinds.of_robot))
    }

    /// Kinds with one topic for the whole fleet.
    pub fn of_fleet() -> impl Iterator<Item = Self> {
        listed(|kinds| &kinds.of_fleet)
    }
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
            sent_in: C::SENT_IN,
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

    /// True if the worker sends one frame of it in every tick, or states in the tick's journal that
    /// it did not.
    pub const fn is_of_tick(self) -> bool {
        let is_of_tick = matches!(self.rows, FrameRows::Robots | FrameRows::Taken);
        is_of_tick && !self.is_of_robot && !matches!(self.flow, Flow::Sources)
    }

    /// True if a tick with this journal sends a frame of it. The worker omits diagnostics under
    /// overload, and sends some kinds only while somebody reads them.
    #[must_use]
    pub fn is_sent_in(self, journal: &TickHeader) -> bool {
        self.is_of_tick() && self.sent_in.is_in(journal.flags)
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
