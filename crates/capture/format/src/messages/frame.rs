//! Frames of any channel as messages.

use std::any::{Any, TypeId};
use std::cell::RefCell;
use std::hash::Hasher;
use std::rc::Rc;

use bytemuck::Pod;
use joulebus_wire::{Channel, FrameHeader as _, FrameOrder, FrameRows, Row as _};

use super::codec::{Decoded, Encoder, MAX_DEPTH, inner};
use super::descriptors;
use super::message::{Content, DecodeError, Message, MessageKind, check_rows, read};
use super::table::Table;

/// A frame of a channel.
#[derive(Debug, Clone)]
pub struct Frame<C: Channel> {
    /// The header.
    pub header: C::Header,
    /// The rows.
    pub rows: Vec<C::Row>,
}

impl<C: Channel> Default for Frame<C> {
    fn default() -> Self {
        Self { header: C::Header::default(), rows: Vec::new() }
    }
}

/// True if all bits are the same.
impl<C: Channel> PartialEq for Frame<C> {
    fn eq(&self, other: &Self) -> bool {
        is_same(&[self.header], &[other.header]) && is_same(&self.rows, &other.rows)
    }
}

/// One robot's row of a frame, repeated for plots.
#[derive(Debug, Clone)]
pub struct RobotRow<C: Channel>(pub C::Row);

/// True if all bits are the same.
impl<C: Channel> PartialEq for RobotRow<C> {
    fn eq(&self, other: &Self) -> bool {
        is_same(&[self.0], &[other.0])
    }
}

fn is_same<T: Pod>(rows: &[T], others: &[T]) -> bool {
    bytemuck::cast_slice::<T, u8>(rows) == bytemuck::cast_slice::<T, u8>(others)
}

/// Encoding of the frames of a channel.
#[derive(Debug)]
struct FrameTable {
    header: Table,
    /// The field of the rows, which comes last.
    number: u32,
    /// The message of a row. None if rows have no fields, and are bytes.
    row: Option<Table>,
}

/// The table of a channel, made at a thread's first use and kept. A table of all threads would need
/// a lock, which a child made by `fork` could find taken for ever.
fn table<C: Channel>() -> Rc<FrameTable> {
    thread_local! {
        static TABLES: RefCell<Vec<(TypeId, Rc<FrameTable>)>> = const { RefCell::new(Vec::new()) };
    }
    TABLES.with_borrow_mut(|tables| {
        let known = tables.iter().find(|(channel, _)| *channel == TypeId::of::<C>());
        if let Some((_, table)) = known {
            return Rc::clone(table);
        }
        let table = Rc::new(FrameTable::new::<C>());
        tables.push((TypeId::of::<C>(), Rc::clone(&table)));
        table
    })
}

impl FrameTable {
    /// # Panics
    /// The channel's fields do not match its message: a fault of the declaration, which every test
    /// of the channel finds.
    fn new<C: Channel>() -> Self {
        match Self::of::<C>() {
            Ok(table) => table,
            Err(why) => panic!("channel {}: {why}", C::SERVICE.name()),
        }
    }

    fn of<C: Channel>() -> Result<Self, String> {
        let set = descriptors::set_of::<C>();
        let find = |name: &str| descriptors::message(&set, name);
        let frame = find(C::MESSAGE).ok_or("its message is not described")?;
        let rows = frame.field.iter().max_by_key(|field| field.number());
        let rows = rows.ok_or("its message has no fields")?;
        let row =
            find(rows.type_name()).map(|row| Table::new(&C::Row::LAYOUT, &row, &find, &[], &[]));
        Ok(Self {
            header: Table::new(&C::Header::LAYOUT, &frame, &find, &[rows.name()], &[])?,
            number: rows.number().unsigned_abs(),
            row: row.transpose()?,
        })
    }
}

impl<C: Channel> Frame<C> {
    pub(super) fn decode(data: &[u8]) -> Result<Message, DecodeError> {
        let room = check_rows(data, 0)?;
        let table = table::<C>();
        let mut header: C::Header = read(&table.header.empty);
        let into = bytemuck::bytes_of_mut(&mut header);
        let row = table.row.as_ref();
        let mut row = row.map(|row| (Decoded::new(row), read::<C::Row>(&row.empty)));
        let (mut rows, mut exceeds) = (Vec::new(), None);
        let mut head = Decoded::new(&table.header);
        head.take(data, into, MAX_DEPTH, &mut |number, wire, data, depth| {
            if number != table.number {
                return Ok(false);
            }
            let found = data.bytes(wire)?;
            let Some((row, empty)) = &mut row else {
                rows.clear();
                rows.extend(found.chunks_exact(size_of::<C::Row>()).map(read::<C::Row>));
                return Ok(true);
            };
            if rows.is_empty() {
                rows.reserve(room);
            }
            rows.push(*empty);
            if let Some(into) = rows.last_mut() {
                row.row(found, bytemuck::bytes_of_mut(into), inner(depth)?, &mut exceeds)?;
            }
            Ok(true)
        })?;
        // Faults of the header are named first.
        let mut exceeds_in_header = None;
        head.end(into, &mut exceeds_in_header);
        match exceeds_in_header.or(exceeds) {
            Some(exceeds) => Err(exceeds.into()),
            None => Ok(Self { header, rows }.into()),
        }
    }
}

impl<C: Channel> Content for Frame<C> {
    fn kind(&self) -> MessageKind {
        MessageKind::of::<C>()
    }

    fn order(&self) -> Option<FrameOrder> {
        Some(self.header.order())
    }

    fn sent_ns(&self) -> Option<u64> {
        self.header.sent_ns()
    }

    fn memory(&self) -> usize {
        size_of_val(self.rows.as_slice())
    }

    fn encode(&self, out: &mut Vec<u8>) {
        let table = table::<C>();
        let FrameTable { header, number, row } = &*table;
        let mut encoder = Encoder::after(std::mem::take(out));
        encoder.fields(header, bytemuck::bytes_of(&self.header));
        match row {
            Some(row) => encoder.rows(*number, row, &self.rows),
            None => encoder.bytes(*number, bytemuck::cast_slice(&self.rows)),
        }
        *out = encoder.finish();
    }

    fn each_robot(&self, take: &mut dyn FnMut(Message)) {
        if C::ROWS == FrameRows::Robots {
            self.rows.iter().for_each(|row| take(RobotRow::<C>(*row).into()));
        }
    }

    fn cloned(&self) -> Box<dyn Content> {
        Box::new(self.clone())
    }

    fn is_same(&self, other: &dyn Content) -> bool {
        let other: &dyn Any = other;
        other.downcast_ref() == Some(self)
    }

    fn hash_bits(&self, state: &mut dyn Hasher) {
        state.write(bytemuck::bytes_of(&self.header));
        state.write(bytemuck::cast_slice(&self.rows));
    }
}

impl<C: Channel> RobotRow<C> {
    pub(super) fn decode(data: &[u8]) -> Result<Message, DecodeError> {
        check_rows(data, 0)?;
        let Some(table) = &table::<C>().row else {
            return Ok(Self(C::Row::default()).into());
        };
        let (mut row, mut exceeds): (C::Row, _) = (read(&table.empty), None);
        let into = bytemuck::bytes_of_mut(&mut row);
        Decoded::new(table).row(data, into, MAX_DEPTH, &mut exceeds)?;
        match exceeds {
            Some(exceeds) => Err(exceeds.into()),
            None => Ok(Self(row).into()),
        }
    }
}

impl<C: Channel> Content for RobotRow<C> {
    fn kind(&self) -> MessageKind {
        MessageKind::of_robot::<C>()
    }

    fn robot(&self) -> Option<u32> {
        C::robot(&self.0)
    }

    fn encode(&self, out: &mut Vec<u8>) {
        if let Some(row) = &table::<C>().row {
            let mut encoder = Encoder::after(std::mem::take(out));
            encoder.fields(row, bytemuck::bytes_of(&self.0));
            *out = encoder.finish();
        }
    }

    fn cloned(&self) -> Box<dyn Content> {
        Box::new(self.clone())
    }

    fn is_same(&self, other: &dyn Content) -> bool {
        let other: &dyn Any = other;
        other.downcast_ref() == Some(self)
    }

    fn hash_bits(&self, state: &mut dyn Hasher) {
        state.write(bytemuck::bytes_of(&self.0));
    }
}

impl Message {
    /// A frame of a channel.
    #[must_use]
    pub fn of<C: Channel>(header: C::Header, rows: Vec<C::Row>) -> Self {
        Frame::<C> { header, rows }.into()
    }

    /// The frame, if it is one of this channel.
    pub fn frame<C: Channel>(&self) -> Option<&Frame<C>> {
        self.get()
    }

    /// The frame to change, if it is one of this channel.
    pub fn frame_mut<C: Channel>(&mut self) -> Option<&mut Frame<C>> {
        self.get_mut()
    }

    /// Same as [`Message::frame`], without a copy.
    ///
    /// # Errors
    /// The message, if it is another.
    pub fn into_frame<C: Channel>(self) -> Result<Frame<C>, Self> {
        self.take()
    }
}
