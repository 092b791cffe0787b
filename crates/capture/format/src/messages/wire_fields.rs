//! The fields of an encoded protobuf message, without decoding them: what a message will take in
//! memory is known before any of it is taken.

use super::codec::{Bytes, MAX_DEPTH};
use super::table::Wire;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Field<'a> {
    pub(crate) number: u32,
    pub(crate) payload: Payload<'a>,
}

/// Contents of a field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Payload<'a> {
    Number,
    /// A message, text, bytes, or numbers one after the other.
    Bytes(&'a [u8]),
    /// The begin or the end of a group. Its fields follow.
    Group,
}

/// The fields of the rest of a message, up to the first that no decoder accepts.
#[derive(Debug, Clone)]
pub(crate) struct Fields<'a>(pub(crate) &'a [u8]);

impl<'a> Iterator for Fields<'a> {
    type Item = Field<'a>;

    fn next(&mut self) -> Option<Field<'a>> {
        let mut rest = Bytes(self.0);
        let (number, wire) = rest.field().ok()?;
        let payload = match wire {
            Wire::Bytes => Payload::Bytes(rest.bytes(wire).ok()?),
            Wire::Group | Wire::GroupEnd => Payload::Group,
            Wire::Varint | Wire::Eight | Wire::Four => {
                rest.skip(number, wire, MAX_DEPTH).ok()?;
                Payload::Number
            }
        };
        self.0 = rest.0;
        Some(Field { number, payload })
    }
}

/// Fields of a message that may be messages themselves, and those within them, `depth` levels down.
pub(crate) fn inner(data: &[u8], depth: u32) -> usize {
    let each = Fields(data).map(|field| match field.payload {
        Payload::Bytes(bytes) if depth > 0 => 1 + inner(bytes, depth - 1),
        Payload::Bytes(_) => 1,
        Payload::Number | Payload::Group => 0,
    });
    each.sum()
}

#[cfg(test)]
mod tests {
    use joulebus_wire::{Sample, SampleHeader, Samples};

    use super::*;
    use crate::{Message, MessageKind};

    #[test]
    fn every_field_that_a_decoder_accepts_is_seen() {
        let row = Sample::new(300, 0, 7).reading(1.5, 7);
        let frame = Message::of::<Samples>(SampleHeader::default(), vec![row; 40]);
        let mut one = Vec::new();
        frame.encode(&mut one);
        let mut data = one.clone();
        // The rows, and the time of sending.
        assert_eq!(inner(&data, 0), 41);
        // Fields of other numbers, a group among them, which decoders skip.
        data.extend([0xf8, 0x07, 0x01, 0xfb, 0x07, 0xfa, 0x07, 0x00, 0xfc, 0x07]);
        data.extend(one);
        let read = Message::decode(MessageKind::of::<Samples>(), &data).unwrap();
        assert_eq!(read.frame::<Samples>().unwrap().rows.len(), 80);
        assert_eq!(inner(&data, 0), 83);
        // Cut anywhere, what is seen is no more than what is there.
        for cut in 0..data.len() {
            assert!(inner(&data[..cut], 2) <= 83 * 3);
        }
        for wrong in [&[0xff; 11][..], &[0x0a, 0x7f], &[0x0e], &[0x09, 1, 2]] {
            assert_eq!(Fields(wrong).next(), None);
        }
    }
}
