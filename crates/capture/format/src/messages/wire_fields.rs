//! The fields of an encoded protobuf message, without decoding them: what a message will take in
//! memory is known before any of it is taken.

/// A field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Field<'a> {
    /// Its number.
    pub(crate) number: u32,
    /// Its contents.
    pub(crate) payload: Payload<'a>,
}

/// Contents of a field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Payload<'a> {
    /// A number.
    Number,
    /// A message, text, bytes, or numbers one after the other.
    Bytes(&'a [u8]),
    /// The begin or the end of a group; its fields follow.
    Group,
}

/// The fields of the rest of a message, up to the first that no decoder accepts.
#[derive(Debug, Clone)]
pub(crate) struct Fields<'a>(pub(crate) &'a [u8]);

impl<'a> Fields<'a> {
    fn number(&mut self) -> Option<u64> {
        let mut number = 0;
        for at in 0..10 {
            let (byte, rest) = self.0.split_first()?;
            self.0 = rest;
            number |= u64::from(byte & 0x7f) << (7 * at);
            if *byte < 0x80 {
                return Some(number);
            }
        }
        None
    }

    fn bytes(&mut self, count: u64) -> Option<&'a [u8]> {
        let (bytes, rest) = self.0.split_at_checked(usize::try_from(count).ok()?)?;
        self.0 = rest;
        Some(bytes)
    }
}

impl<'a> Iterator for Fields<'a> {
    type Item = Field<'a>;

    fn next(&mut self) -> Option<Field<'a>> {
        let key = self.number()?;
        let payload = match key & 7 {
            0 => self.number().map(|_| Payload::Number),
            1 => self.bytes(8).map(|_| Payload::Number),
            2 => {
                let count = self.number()?;
                self.bytes(count).map(Payload::Bytes)
            }
            3 | 4 => Some(Payload::Group),
            5 => self.bytes(4).map(|_| Payload::Number),
            _ => None,
        };
        let number = u32::try_from(key >> 3).ok()?;
        payload.map(|payload| Field { number, payload })
    }
}

/// Fields of a message that may be messages themselves; and those within them, `depth` levels down.
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
