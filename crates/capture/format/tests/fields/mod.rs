//! Messages with arbitrary bits.
#![allow(dead_code, reason = "each test uses a part")]

use joulebus_capture_format::{Message, MessageKind, Query};
use joulebus_wire::{
    Channel, DropCounts, FieldLayout, FieldType, ForEachChannel, Queries, Refusal, Row,
    each_channel,
};

/// Arbitrary bits, often special values: zeros, ones, -0, infinities, NaNs with and without sign.
pub(crate) struct Bits(pub(crate) u64);

impl Bits {
    pub(crate) fn u64(&mut self) -> u64 {
        // SplitMix64, as published by Steele, Lea and Flood.
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^= z >> 31;
        let awkward = [0, 1, u64::MAX, 1 << 63, 0x8000_0000_8000_0000];
        match z % 16 {
            0..=4 => awkward[(z % 16) as usize],
            5 => z | 0x7ff0_0000_7f80_0000,
            _ => z,
        }
    }

    pub(crate) fn u16(&mut self) -> u16 {
        self.u64() as u16
    }

    pub(crate) fn rows<T>(&mut self, row: impl Fn(&mut Self) -> T) -> Vec<T> {
        (0..self.u64() % 5).map(|_| row(self)).collect()
    }

    /// A struct, each of whose numbers is arbitrary; in an array those after an arbitrary place are
    /// 0.
    pub(crate) fn row<T: Row>(&mut self) -> T {
        let mut row = T::default();
        let bytes = bytemuck::bytes_of_mut(&mut row);
        match T::LAYOUT.fields {
            [] => self.number(bytes),
            fields => fields.iter().for_each(|field| self.fill(field, &mut bytes[field.offset..])),
        }
        row
    }

    fn fill(&mut self, field: &FieldLayout, into: &mut [u8]) {
        let into = &mut into[..field.size];
        let size = field.size / field.elements.unwrap_or(1);
        if field.of == FieldType::U8 {
            let text = "ω k".repeat(self.u16() as usize % (into.len() / 4));
            return into[..text.len()].copy_from_slice(text.as_bytes());
        }
        let used = match field.elements {
            Some(elements) => (self.u64() % (elements as u64 + 1)) as usize,
            None => 1,
        };
        for element in into.chunks_mut(size).take(used) {
            match field.of {
                FieldType::Struct("Refusal") => {
                    element.copy_from_slice(bytemuck::bytes_of(&self.row::<Refusal>()));
                }
                FieldType::Struct("DropCounts") => {
                    element.copy_from_slice(bytemuck::bytes_of(&self.row::<DropCounts>()));
                }
                // What it counts follows from other parts.
                FieldType::Struct(_) => {}
                _ => self.number(element),
            }
        }
    }

    fn number(&mut self, into: &mut [u8]) {
        let bits = self.u64().to_le_bytes();
        into.copy_from_slice(&bits[..into.len()]);
    }

    pub(crate) fn query(&mut self) -> Query {
        let mut query = Query {
            record: self.row(),
            values: self.rows(|bits| f64::from_bits(bits.u64())),
            rows: self.rows(Self::row),
            power_w: self.rows(|bits| f32::from_bits(bits.u64() as u32)),
            text: "ω ".repeat(self.u16() as usize % 5),
        };
        query.record.query = self.row();
        query.record.answer = self.row();
        query.counted()
    }
}

/// One message of each kind, with arbitrary bits.
pub(crate) fn messages(bits: &mut Bits) -> Vec<Message> {
    struct Each<'a>(&'a mut Bits, Vec<Message>);
    impl ForEachChannel for Each<'_> {
        fn channel<C: Channel>(&mut self) {
            let Self(bits, messages) = self;
            let kind = MessageKind::of::<C>();
            if kind == MessageKind::of::<Queries>() {
                messages.push(bits.query().into());
                return;
            }
            messages.push(Message::of::<C>(bits.row(), bits.rows(Bits::row)));
            if kind.has_robots() {
                Message::of::<C>(bits.row(), vec![bits.row()]).each_robot(|row| messages.push(row));
            }
        }
    }
    let mut each = Each(bits, Vec::new());
    each_channel(&mut each);
    assert_eq!(each.1.len(), MessageKind::all().count());
    each.1
}
