//! A frame of any channel.

use std::any::TypeId;
use std::sync::{PoisonError, RwLock};

use joulebus_wire::{Channel, Row as _};

use super::DecodeError;
use super::codec::{Decoded, Encoder, MAX_DEPTH, inner};
use super::descriptors;
use super::table::Table;

/// A frame of a channel.
#[derive(Debug, Clone)]
pub struct Frame<C: Channel> {
    /// What it begins with.
    pub header: C::Header,
    /// What it consists of.
    pub rows: Vec<C::Row>,
}

/// How the frames of a channel are encoded.
#[derive(Debug)]
pub(super) struct FrameTable {
    header: Table,
    /// The field of the rows, which comes last.
    number: u32,
    /// The message of a row; none if the rows are bytes.
    pub(super) row: Option<Table>,
}

/// That of the channel. Made when it is first needed, and kept.
pub(super) fn table<C: Channel>() -> &'static FrameTable {
    static TABLES: RwLock<Vec<(TypeId, &FrameTable)>> = RwLock::new(Vec::new());
    let find = |tables: &[(TypeId, &'static FrameTable)]| {
        let mut tables = tables.iter();
        tables.find(|(channel, _)| *channel == TypeId::of::<C>()).map(|(_, table)| *table)
    };
    if let Some(table) = find(&TABLES.read().unwrap_or_else(PoisonError::into_inner)) {
        return table;
    }
    let mut tables = TABLES.write().unwrap_or_else(PoisonError::into_inner);
    if let Some(table) = find(&tables) {
        return table;
    }
    let table = FrameTable::new::<C>();
    assert!(table.is_ok(), "{}: {}", C::MESSAGE, table.unwrap_err());
    let table = Box::leak(Box::new(table.unwrap()));
    tables.push((TypeId::of::<C>(), table));
    table
}

impl FrameTable {
    fn new<C: Channel>() -> Result<Self, String> {
        let set = descriptors::set_of::<C>();
        let find = |name: &str| descriptors::message(&set, name);
        let frame = find(C::MESSAGE).ok_or("it has no message")?;
        let rows = frame.field.iter().max_by_key(|field| field.number());
        let rows = rows.ok_or("its message has no fields")?;
        let row = find(rows.type_name());
        Ok(Self {
            header: Table::new(&C::Header::LAYOUT, &frame, &find, &[rows.name()], &[])?,
            number: rows.number().unsigned_abs(),
            row: match row {
                Some(row) => Some(Table::new(&C::Row::LAYOUT, &row, &find, &[], &[])?),
                None => None,
            },
        })
    }
}

impl<C: Channel> Frame<C> {
    /// Appends its protobuf encoding.
    pub(super) fn encode(&self, out: &mut Vec<u8>) {
        let FrameTable { header, number, row } = table::<C>();
        let mut encoder = Encoder::after(std::mem::take(out));
        encoder.fields(header, bytemuck::bytes_of(&self.header));
        match row {
            Some(row) => encoder.rows(*number, row, &self.rows),
            None => encoder.bytes(*number, bytemuck::cast_slice(&self.rows)),
        }
        *out = encoder.finish();
    }

    /// `room` is the maximum number of rows.
    pub(super) fn decode(data: &[u8], room: usize) -> Result<Self, DecodeError> {
        let table = table::<C>();
        let mut header: C::Header = bytemuck::pod_read_unaligned(&table.header.empty);
        let into = bytemuck::bytes_of_mut(&mut header);
        let mut decoded = Decoded::new(&table.header);
        let mut row = table.row.as_ref().map(|row| (Decoded::new(row), bytemuck::pod_read_unaligned(&row.empty)));
        let (mut rows, mut exceeds) = (Vec::new(), None);
        decoded.take(data, into, MAX_DEPTH, &mut |number, wire, data, depth| {
            if number != table.number {
                return Ok(false);
            }
            let found = data.bytes(wire)?;
            let Some((row, empty)) = &mut row else {
                rows.clear();
                rows.extend_from_slice(bytemuck::cast_slice(found));
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
        // Those of the header are named first.
        let mut exceeds_in_header = None;
        decoded.end(into, &mut exceeds_in_header);
        match exceeds_in_header.or(exceeds) {
            Some(exceeds) => Err(exceeds.into()),
            None => Ok(Self { header, rows }),
        }
    }
}
