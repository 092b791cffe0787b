//! Checks the lengths in a record against the record, before anything is allocated for them.

use mcap::records::op;

#[derive(Debug, Clone, Copy)]
enum Field {
    /// A record of fixed length.
    Fixed(usize),
    /// Text: a length of four bytes, then so many bytes.
    Counted,
    /// Fixed-size entries: a length of four bytes, then so many bytes. The library reads whole
    /// entries, beyond the length if it ends within one.
    Entries(usize),
    /// Pairs of texts: a length of four bytes, then so many bytes.
    Texts,
    /// Data: a length of eight bytes, then so many bytes.
    Data,
}

use Field::{Counted, Data, Entries, Fixed, Texts};

/// Fields of the record kinds that contain lengths, or are of one length.
const fn fields(opcode: u8) -> &'static [Field] {
    match opcode {
        op::HEADER => &[Counted, Counted],
        op::SCHEMA => &[Fixed(2), Counted, Counted, Counted],
        op::CHANNEL => &[Fixed(4), Counted, Counted, Texts],
        op::MESSAGE_INDEX => &[Fixed(2), Entries(16)],
        op::CHUNK => &[Fixed(28), Counted, Data],
        op::CHUNK_INDEX => &[Fixed(32), Entries(10), Fixed(8), Counted, Fixed(16)],
        op::ATTACHMENT => &[Fixed(16), Counted, Counted, Data, Fixed(4)],
        op::ATTACHMENT_INDEX => &[Fixed(40), Counted, Counted],
        op::STATISTICS => &[Fixed(42), Entries(10)],
        op::METADATA => &[Counted, Texts],
        op::METADATA_INDEX => &[Fixed(16), Counted],
        op::DATA_END => &[Fixed(4)],
        op::SUMMARY_OFFSET => &[Fixed(17)],
        _ => &[],
    }
}

/// True if the body of a record contains all its fields.
pub(super) fn fits(opcode: u8, body: &[u8]) -> bool {
    spare(opcode, body).is_some()
}

/// Bytes of a record's body after its fields, which later versions of the format may use. `None` if
/// a field is incomplete.
pub(super) fn spare(opcode: u8, body: &[u8]) -> Option<usize> {
    let fields = fields(opcode);
    let mut rest = body;
    fields.iter().try_for_each(|field| pass(*field, &mut rest))?;
    Some(if fields.is_empty() { 0 } else { rest.len() })
}

/// Skips a field. `None` if it is incomplete.
fn pass(field: Field, rest: &mut &[u8]) -> Option<()> {
    match field {
        Fixed(bytes) => {
            take(bytes, rest)?;
        }
        Counted => {
            counted(rest)?;
        }
        Entries(bytes) => {
            let entries = counted(rest)?;
            entries.len().is_multiple_of(bytes).then_some(())?;
        }
        Texts => {
            let mut texts = counted(rest)?;
            while !texts.is_empty() {
                counted(&mut texts)?;
                counted(&mut texts)?;
            }
        }
        Data => {
            let length = take(8, rest)?.first_chunk::<8>()?;
            take(usize::try_from(u64::from_le_bytes(*length)).ok()?, rest)?;
        }
    }
    Some(())
}

fn counted<'a>(rest: &mut &'a [u8]) -> Option<&'a [u8]> {
    let length = take(4, rest)?.first_chunk::<4>()?;
    take(usize::try_from(u32::from_le_bytes(*length)).ok()?, rest)
}

fn take<'a>(bytes: usize, rest: &mut &'a [u8]) -> Option<&'a [u8]> {
    let (taken, left) = rest.split_at_checked(bytes)?;
    *rest = left;
    Some(taken)
}
