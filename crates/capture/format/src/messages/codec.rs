//! Protobuf to and from structs of shared memory, by their [`Table`], bit for bit.

use std::fmt;

use joulebus_wire::text;

use super::table::{Field, Form, MAX_VARINT, Number, Plain, Table, Wire, encoded, key};

/// Bytes that are written at once, of which the last may be superfluous.
pub(super) const WORD: usize = 8;
/// By how much a buffer grows beyond what is needed, bytes.
const PAGE: usize = 4_096;
/// Maximum nesting depth of what is decoded.
pub(super) const MAX_DEPTH: u32 = 100;

/// A number in a capture that exceeds its field in shared memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{field} = {found}: allowed are 0 to {allowed}")]
#[allow(missing_docs)] // The messages name the fields.
pub struct OutOfRange {
    pub field: &'static str,
    pub found: i128,
    pub allowed: u64,
}

/// Reason that bytes are no message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(super) enum Wrong {
    #[error("buffer underflow")]
    Underflow,
    #[error("invalid varint")]
    Varint,
    #[error("invalid key value")]
    Key,
    #[error("invalid tag value: 0")]
    Tag,
    #[error("invalid wire type")]
    Wire,
    #[error("unexpected end group tag")]
    GroupEnd,
    #[error("recursion limit reached")]
    Depth,
    #[error("invalid string value: data is not UTF-8 encoded")]
    Text,
}

/// Reason that bytes are no message, and the place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Fault {
    wrong: Wrong,
    /// The innermost field in which it is.
    field: Option<&'static str>,
}

impl fmt::Display for Fault {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "failed to decode Protobuf message: ")?;
        if let Some(field) = self.field {
            write!(out, "{field}: ")?;
        }
        write!(out, "{}", self.wrong)
    }
}

impl Fault {
    fn within(self, field: &Field) -> Self {
        Self { field: self.field.or(Some(field.name)), ..self }
    }
}

impl From<Wrong> for Fault {
    fn from(wrong: Wrong) -> Self {
        Self { wrong, field: None }
    }
}

/// The rest of a message.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bytes<'a>(pub(super) &'a [u8]);

impl<'a> Bytes<'a> {
    pub(super) const fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    #[inline]
    pub(super) fn varint(&mut self) -> Result<u64, Wrong> {
        match self.0.split_first() {
            Some((byte, rest)) if *byte < 0x80 => {
                self.0 = rest;
                Ok(u64::from(*byte))
            }
            _ => self.long_varint(),
        }
    }

    fn long_varint(&mut self) -> Result<u64, Wrong> {
        let mut number = 0;
        for (at, byte) in self.0.iter().take(MAX_VARINT).enumerate() {
            number |= u64::from(byte & 0x7f) << (7 * at);
            if *byte < 0x80 {
                if at == MAX_VARINT - 1 && *byte > 1 {
                    break;
                }
                self.0 = &self.0[at + 1..];
                return Ok(number);
            }
        }
        Err(Wrong::Varint)
    }

    #[inline]
    fn array<const N: usize>(&mut self) -> Result<[u8; N], Wrong> {
        let (bytes, rest) = self.0.split_first_chunk().ok_or(Wrong::Underflow)?;
        self.0 = rest;
        Ok(*bytes)
    }

    /// Number and encoding of the next field, as one.
    #[inline]
    fn key(&mut self) -> Result<u32, Wrong> {
        u32::try_from(self.varint()?).map_err(|_| Wrong::Key)
    }

    /// Number and encoding of the next field.
    pub(super) fn field(&mut self) -> Result<(u32, Wire), Wrong> {
        parts(self.key()?)
    }

    /// Contents with their length before them.
    pub(super) fn bytes(&mut self, wire: Wire) -> Result<&'a [u8], Wrong> {
        if wire != Wire::Bytes {
            return Err(Wrong::Wire);
        }
        let count = usize::try_from(self.varint()?).unwrap_or(usize::MAX);
        let (bytes, rest) = self.0.split_at_checked(count).ok_or(Wrong::Underflow)?;
        self.0 = rest;
        Ok(bytes)
    }

    /// Passes over the contents of a field that is not known.
    pub(super) fn skip(&mut self, number: u32, wire: Wire, depth: u32) -> Result<(), Wrong> {
        let depth = inner(depth)?;
        match wire {
            Wire::Varint => self.varint().map(drop),
            Wire::Eight => self.array::<8>().map(drop),
            Wire::Four => self.array::<4>().map(drop),
            Wire::Bytes => self.bytes(wire).map(drop),
            Wire::Group => loop {
                match self.field()? {
                    (end, Wire::GroupEnd) if end == number => return Ok(()),
                    (number, wire) => self.skip(number, wire, depth)?,
                }
            },
            Wire::GroupEnd => Err(Wrong::GroupEnd),
        }
    }

    /// Calls `each` with the numbers of a repeated field, which may come one by one.
    pub(super) fn numbers(
        &mut self,
        of: Number,
        wire: Wire,
        mut each: impl FnMut(u64),
    ) -> Result<(), Wrong> {
        if wire == of.wire() {
            each(self.number(of)?);
            return Ok(());
        }
        let mut packed = Bytes(self.bytes(wire)?);
        while !packed.is_empty() {
            each(packed.number(of)?);
        }
        Ok(())
    }

    /// A number as 64 bits, of which those that exceed it are to be ignored.
    #[inline]
    fn number(&mut self, of: Number) -> Result<u64, Wrong> {
        match of.wire() {
            Wire::Eight => Ok(u64::from_le_bytes(self.array()?)),
            Wire::Four => Ok(u32::from_le_bytes(self.array()?).into()),
            _ => self.varint(),
        }
    }
}

#[cold]
fn named(table: &Table, key: u32, wrong: Wrong) -> Fault {
    let fault = Fault::from(wrong);
    match table.by_number(key >> 3) {
        Some(field) => fault.within(field),
        None => fault,
    }
}

fn parts(key: u32) -> Result<(u32, Wire), Wrong> {
    let wire = match key & 7 {
        0 => Wire::Varint,
        1 => Wire::Eight,
        2 => Wire::Bytes,
        3 => Wire::Group,
        4 => Wire::GroupEnd,
        5 => Wire::Four,
        _ => return Err(Wrong::Wire),
    };
    match key >> 3 {
        0 => Err(Wrong::Tag),
        number => Ok((number, wire)),
    }
}

/// The depth left within a message.
pub(super) const fn inner(depth: u32) -> Result<u32, Wrong> {
    match depth.checked_sub(1) {
        Some(depth) => Ok(depth),
        None => Err(Wrong::Depth),
    }
}

impl Number {
    #[inline]
    fn read(self, from: &[u8]) -> u64 {
        match self {
            Self::U16 | Self::Code16 => u16::from_ne_bytes(first(from)).into(),
            Self::U32 | Self::F32 => u32::from_ne_bytes(first(from)).into(),
            Self::Code32 => i64::from(i32::from_ne_bytes(first(from))) as u64,
            Self::U64 | Self::Fixed | Self::F64 => u64::from_ne_bytes(first(from)),
        }
    }
}

/// The first bytes, which are there by the layout.
#[inline]
fn first<const N: usize>(from: &[u8]) -> [u8; N] {
    from.first_chunk().copied().unwrap_or([0; N])
}

#[inline]
fn put<const N: usize>(into: &mut [u8], number: [u8; N]) {
    if let Some(place) = into.first_chunk_mut() {
        *place = number;
    }
}

/// The end of a message that is being encoded.
#[derive(Debug)]
pub(super) struct Encoder {
    /// With room for a whole [`WORD`] after the end.
    bytes: Vec<u8>,
    end: usize,
}

impl Encoder {
    /// Appends to these bytes.
    pub(super) const fn after(bytes: Vec<u8>) -> Self {
        let end = bytes.len();
        Self { bytes, end }
    }

    pub(super) fn finish(mut self) -> Vec<u8> {
        self.bytes.truncate(self.end);
        self.bytes
    }

    fn reserve(&mut self, bytes: usize) {
        let needed = self.end + bytes + WORD;
        if self.bytes.len() < needed {
            self.bytes.resize(needed + PAGE, 0);
        }
    }

    /// Appends the fields of a struct.
    pub(super) fn fields(&mut self, table: &Table, from: &[u8]) {
        self.reserve(table.longest);
        self.write(table, from);
    }

    /// Appends a field of structs.
    pub(super) fn rows<T: bytemuck::Pod>(&mut self, number: u32, table: &Table, rows: &[T]) {
        let (key, mut guess) = (encoded(key(number, Wire::Bytes)), 1);
        for row in rows {
            self.reserve(table.longest + 2 * MAX_VARINT);
            self.inner(key, &mut guess, |this| {
                this.write(table, bytemuck::bytes_of(row));
            });
        }
    }

    /// Appends a field of what `write` appends.
    pub(super) fn part(&mut self, number: u32, write: impl FnOnce(&mut Self)) {
        self.reserve(2 * MAX_VARINT);
        self.inner(encoded(key(number, Wire::Bytes)), &mut 1, |this| {
            write(this);
            this.reserve(MAX_VARINT);
        });
    }

    /// Appends a field of bytes, unless there are none.
    pub(super) fn bytes(&mut self, number: u32, bytes: &[u8]) {
        self.reserve(2 * MAX_VARINT + bytes.len());
        self.bytes_of_key(encoded(key(number, Wire::Bytes)), bytes);
    }

    fn bytes_of_key(&mut self, (key, used): (u64, usize), bytes: &[u8]) {
        if !bytes.is_empty() {
            self.word(key, used);
            self.varint(bytes.len() as u64);
            self.bytes[self.end..self.end + bytes.len()].copy_from_slice(bytes);
            self.end += bytes.len();
        }
    }

    /// Writes a word, of which `used` bytes count.
    #[inline]
    fn word(&mut self, word: u64, used: usize) {
        if let Some(place) = self.bytes[self.end..].first_chunk_mut() {
            *place = word.to_le_bytes();
        }
        self.end += used;
    }

    #[inline]
    fn varint(&mut self, mut number: u64) {
        while number >= 0x80 {
            self.word(number | 0x80, 1);
            number >>= 7;
        }
        self.word(number, 1);
    }

    /// Writes a number unless it is 0. A float is always written.
    #[inline]
    fn number(&mut self, field: &Field, of: Number, from: &[u8]) {
        let (key, used) = field.key;
        match of {
            // A key of a row is short.
            Number::F32 if used <= 4 => {
                let bits = u64::from(u32::from_ne_bytes(first(from)));
                self.word(key | bits << (8 * used), used + 4);
            }
            Number::F32 | Number::F64 => {
                self.word(key, used);
                self.element(of, of.read(from));
            }
            _ => {
                let number = of.read(from);
                if number != 0 {
                    self.word(key, used);
                    self.element(of, number);
                }
            }
        }
    }

    #[inline]
    fn element(&mut self, of: Number, number: u64) {
        match of.wire() {
            Wire::Eight => self.word(number, 8),
            Wire::Four => self.word(number, 4),
            _ => self.varint(number),
        }
    }

    /// Writes a field whose contents `write` writes. `guess` are the bytes of the length before,
    /// and then of this one: the contents are moved where it is another.
    fn inner(&mut self, key: (u64, usize), guess: &mut usize, write: impl FnOnce(&mut Self)) {
        self.word(key.0, key.1);
        let at = self.end;
        self.end += *guess;
        write(self);
        let (begin, end) = (at + *guess, self.end);
        let mut length = (end - begin) as u64;
        let needed = (length | 1).ilog2() as usize / 7 + 1;
        if needed != *guess {
            self.bytes.copy_within(begin..end, at + needed);
            self.end = end + needed - *guess;
            *guess = needed;
        }
        for byte in &mut self.bytes[at..at + needed] {
            *byte = length as u8 | 0x80;
            length >>= 7;
        }
        self.bytes[at + needed - 1] &= 0x7f;
    }

    fn write(&mut self, table: &Table, from: &[u8]) {
        for field in &table.fields {
            let from = &from[field.offset..];
            match &field.form {
                Form::Number(of) | Form::Float(of) => self.number(field, *of, from),
                Form::Time(_) => self.inner(field.key, &mut 1, |this| {
                    let ns = u64::from_ne_bytes(first(from));
                    for (key, part) in [(1 << 3, ns / 1_000_000_000), (2 << 3, ns % 1_000_000_000)]
                    {
                        if part != 0 {
                            this.word(key, 1);
                            this.varint(part);
                        }
                    }
                }),
                Form::Numbers { of, elements, .. } => {
                    let size = of.size();
                    let used =
                        if of.is_float() { elements * size } else { used(from, *elements, size) };
                    if used > 0 {
                        self.inner(field.key, &mut 1, |this| {
                            for element in from[..used].chunks_exact(size) {
                                this.element(*of, of.read(element));
                            }
                        });
                    }
                }
                Form::Text(size) => self.bytes_of_key(field.key, text(&from[..*size]).as_bytes()),
                Form::Struct(table) => {
                    self.inner(field.key, &mut 1, |this| this.write(table, from));
                }
                Form::Structs { of, elements, .. } => {
                    let size = of.empty.len();
                    let used = used(from, *elements, size);
                    for element in from[..used].chunks_exact(size) {
                        self.inner(field.key, &mut 1, |this| this.write(of, element));
                    }
                }
            }
        }
    }
}

/// Bytes of an array up to its last element that is not zero.
fn used(from: &[u8], elements: usize, size: usize) -> usize {
    let mut elements = from[..elements * size].chunks_exact(size);
    let last = elements.rposition(|element| element.iter().any(|byte| *byte != 0));
    last.map_or(0, |last| (last + 1) * size)
}

/// A struct that is being decoded, from one or several pieces of a message.
#[derive(Debug)]
pub(super) struct Decoded<'a> {
    table: &'a Table,
    slots: Vec<u64>,
    /// Numbers that exceed their fields, unless they are followed by others. With the offset of the
    /// field.
    wide: Vec<(usize, OutOfRange)>,
}

/// Takes a field that is not in the struct. False if it is not known. Has its number, the message,
/// and the depth left.
pub(super) type Part<'a> = &'a mut dyn FnMut(u32, Wire, &mut Bytes<'_>, u32) -> Result<bool, Fault>;

impl<'a> Decoded<'a> {
    pub(super) fn new(table: &'a Table) -> Self {
        Self { table, slots: vec![0; table.slots], wide: Vec::new() }
    }

    /// Decodes a whole message. Afterwards another can be decoded. A number that exceeds its field
    /// becomes `exceeds`, unless there is one already.
    pub(super) fn row(
        &mut self,
        data: &[u8],
        into: &mut [u8],
        depth: u32,
        exceeds: &mut Option<OutOfRange>,
    ) -> Result<(), Fault> {
        self.take(data, into, depth, &mut |_, _, _, _| Ok(false))?;
        self.end(into, exceeds);
        Ok(())
    }

    /// Takes the fields of a piece of the message. `part` those that are not of the struct.
    pub(super) fn take(
        &mut self,
        data: &[u8],
        into: &mut [u8],
        depth: u32,
        part: Part<'_>,
    ) -> Result<(), Fault> {
        self.fields(self.table, data, (into, 0), depth, part)
    }

    fn fields(
        &mut self,
        table: &Table,
        data: &[u8],
        (into, base): (&mut [u8], usize),
        depth: u32,
        part: Part<'_>,
    ) -> Result<(), Fault> {
        let mut data = Bytes(data);
        while !data.is_empty() {
            let key = data.key()?;
            // Quick, because most fields are plain numbers.
            if let Some(Plain { offset, of }) = table.plain(key) {
                let offset = offset as usize;
                let number = data.number(of);
                let number = number.map_err(|wrong| named(table, key, wrong))?;
                match of.size() {
                    8 => put(&mut into[offset..], number.to_ne_bytes()),
                    4 => put(&mut into[offset..], (number as u32).to_ne_bytes()),
                    _ => {
                        if let Some(field) = table.by_number(key >> 3) {
                            self.put(field, of, number, (&mut into[offset..], base + offset));
                        }
                    }
                }
                continue;
            }
            let (number, wire) = parts(key)?;
            let Some(field) = table.by_number(number) else {
                if !part(number, wire, &mut data, depth)? {
                    data.skip(number, wire, depth)?;
                }
                continue;
            };
            let place = (&mut into[field.offset..], base + field.offset);
            let taken = self.field(field, wire, &mut data, place, depth);
            taken.map_err(|fault| fault.within(field))?;
        }
        Ok(())
    }

    fn field(
        &mut self,
        field: &Field,
        wire: Wire,
        data: &mut Bytes<'_>,
        (into, base): (&mut [u8], usize),
        depth: u32,
    ) -> Result<(), Fault> {
        match &field.form {
            // With the right wire type it was taken.
            Form::Number(_) | Form::Float(_) => return Err(Wrong::Wire.into()),
            Form::Time(slot) => {
                let mut time = Bytes(data.bytes(wire)?);
                let depth = inner(depth)?;
                while !time.is_empty() {
                    match time.field()? {
                        (1, Wire::Varint) => self.slots[*slot] = time.varint()?,
                        (2, Wire::Varint) => self.slots[*slot + 1] = time.varint()?,
                        (1 | 2, _) => return Err(Wrong::Wire.into()),
                        (number, wire) => time.skip(number, wire, depth)?,
                    }
                }
            }
            Form::Numbers { of, elements, slot } => {
                data.numbers(*of, wire, |number| {
                    let place = self.slots[*slot] as usize;
                    self.slots[*slot] += 1;
                    if place < *elements {
                        let at = place * of.size();
                        self.put(field, *of, number, (&mut into[at..], base + at));
                    }
                })?;
            }
            Form::Text(size) => {
                let found = str::from_utf8(data.bytes(wire)?).map_err(|_| Wrong::Text)?;
                let found = text(&found.as_bytes()[..found.len().min(*size)]);
                into[..*size].fill(0);
                into[..found.len()].copy_from_slice(found.as_bytes());
            }
            Form::Struct(table) => {
                let data = data.bytes(wire)?;
                let place = (&mut into[..table.empty.len()], base);
                self.fields(table, data, place, inner(depth)?, &mut |_, _, _, _| Ok(false))?;
            }
            Form::Structs { of, elements, slot } => {
                let mut element = of.empty.clone();
                let data = data.bytes(wire)?;
                let mut wide = None;
                Decoded::new(of).row(data, &mut element, inner(depth)?, &mut wide)?;
                let place = self.slots[*slot] as usize;
                self.slots[*slot] += 1;
                if place < *elements {
                    let at = place * element.len();
                    into[at..at + element.len()].copy_from_slice(&element);
                    self.wide.extend(wide.map(|wide| (base + at, wide)));
                }
            }
        }
        Ok(())
    }

    #[inline]
    fn put(&mut self, field: &Field, of: Number, number: u64, (into, base): (&mut [u8], usize)) {
        match of.size() {
            8 => put(into, number.to_ne_bytes()),
            4 => put(into, (number as u32).to_ne_bytes()),
            _ => {
                if !self.wide.is_empty() {
                    self.wide.retain(|(offset, _)| *offset != base);
                }
                match u16::try_from(number as u32) {
                    Ok(number) => put(into, number.to_ne_bytes()),
                    Err(_) => self.exceeds(
                        field,
                        base,
                        match of {
                            Number::Code16 => i128::from(number as i32),
                            _ => i128::from(number as u32),
                        },
                        u16::MAX.into(),
                    ),
                }
            }
        }
    }

    fn exceeds(&mut self, field: &Field, base: usize, found: i128, allowed: u64) {
        let wide = OutOfRange { field: field.name, found, allowed };
        self.wide.push((base, wide));
    }

    /// Ends the message, as [`Decoded::row`] does.
    pub(super) fn end(&mut self, into: &mut [u8], exceeds: &mut Option<OutOfRange>) {
        if !self.slots.is_empty() {
            self.times(self.table, (into, 0));
            self.slots.fill(0);
        }
        if !self.wide.is_empty() {
            let first = self.wide.drain(..).min_by_key(|(offset, _)| *offset);
            *exceeds = exceeds.or(first.map(|(_, wide)| wide));
        }
    }

    fn times(&mut self, table: &Table, (into, base): (&mut [u8], usize)) {
        for field in &table.fields {
            let (into, base) = (&mut into[field.offset..], base + field.offset);
            match &field.form {
                Form::Time(slot) => {
                    let seconds = i128::from(self.slots[*slot] as i64);
                    let found = seconds * 1_000_000_000 + i128::from(self.slots[*slot + 1] as i32);
                    match u64::try_from(found) {
                        Ok(ns) => put(into, ns.to_ne_bytes()),
                        Err(_) => self.exceeds(field, base, found, u64::MAX),
                    }
                }
                Form::Struct(table) => self.times(table, (into, base)),
                _ => {}
            }
        }
    }
}
