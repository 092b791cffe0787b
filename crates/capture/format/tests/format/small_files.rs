//! A small file costs bounded work and memory, whatever its messages and schemas contain.

use joulebus_capture_format::{DecodeError, Message, MessageKind};

/// Rows that a message may have.
const MAX_ROWS: usize = 1 << 20;

#[test]
fn no_message_of_empty_rows_is_decoded_that_has_more_than_a_fleet_has_robots() {
    for kind in MessageKind::all() {
        for number in [1_u8, 5, 16, 20, 30] {
            let tag = u16::from(number) << 3 | 2;
            let empty = match u8::try_from(tag) {
                Ok(tag) if tag < 0x80 => vec![tag, 0],
                _ => vec![(tag & 0x7f) as u8 | 0x80, (tag >> 7) as u8, 0],
            };
            let rows = empty.repeat(MAX_ROWS + 1);
            let is_refused = |data: &[u8]| {
                matches!(
                    Message::decode(kind, data),
                    Err(DecodeError::TooManyRows { found }) if found > MAX_ROWS
                )
            };
            assert!(is_refused(&rows), "{kind:?}, {number}");
            // In the answer of a question.
            if kind == MessageKind::of::<joulebus_wire::Queries>() {
                let mut answer = empty[..empty.len() - 1].to_vec();
                prost::encoding::encode_varint(rows.len() as u64, &mut answer);
                answer.extend(&rows);
                assert!(is_refused(&answer), "{number}");
            }
        }
    }
}
