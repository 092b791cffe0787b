//! A capture written by the program of 24 November 2026 (1bf363c, whose captures are those of the
//! release df6ba14): it is read to the same bits, and the same is written. Plan states,
//! budgets and questions have changed since, and are read.

use std::collections::BTreeSet;
use std::io::Cursor;

use joulebus_capture_format::{Message, MessageKind, Reader};
use joulebus_wire::{Channel, ForEachChannel, PlanStates, Queries, State, each_channel};

use crate::bits::{assert_described, dynamic};

/// Three messages of each kind that there was, with arbitrary bits: all but acknowledgements and
/// outlooks.
const EARLIER: &[u8] = include_bytes!("../earlier.mcap");

/// Compares a message with the same bytes decoded by the file's schema.
struct Same<'a>(&'a Message, &'a [u8]);

impl ForEachChannel for Same<'_> {
    fn channel<C: Channel>(&mut self) {
        let kind = MessageKind::of::<C>();
        if self.0.kind() == Some(kind) {
            let read = dynamic(kind, self.1);
            assert_described::<C>(self.0, &read);
        }
    }
}

#[test]
fn an_earlier_capture_is_read_to_the_same_bits_and_the_same_is_written() {
    let mut reader = Reader::new(Cursor::new(EARLIER)).unwrap();
    let mut schemas = BTreeSet::new();
    let mut count = 0;
    for earlier in mcap::MessageStream::new(EARLIER).unwrap() {
        let earlier = earlier.unwrap();
        let entry = reader.next_entry().unwrap().unwrap();
        let kind = entry.message.kind().unwrap();
        let robot = entry.message.robot().unwrap_or(0);
        assert_eq!(earlier.channel.topic, kind.topic("lab", robot));
        let schema = earlier.channel.schema.as_ref().unwrap();
        assert_eq!(schema.name, kind.schema());
        schemas.insert(schema.name.clone());
        count += 1;
        // Factors of the errors became bounds, budgets have pauses, and questions have a tolerance for
        // a reserved field, which these frames do not have.
        let has_other = [MessageKind::of::<PlanStates>(), MessageKind::of::<Queries>()];
        if has_other.contains(&kind) || schema.name.contains("Budget") {
            continue;
        }
        // Two alarms have names in the schema that they had not, and keyframes name the one before:
        // the bits are the same.
        let has_more = schema.name.contains("Diagnostic") || kind == MessageKind::of::<State>();
        assert!(has_more || *schema.data == kind.descriptors(), "{kind:?}");
        let mut written = Vec::new();
        entry.message.encode(&mut written);
        assert_eq!(*earlier.data, written, "{kind:?}");
        each_channel(&mut Same(&entry.message, &earlier.data));
    }
    assert!(reader.next_entry().unwrap().is_none());
    assert_eq!((schemas.len(), count), (MessageKind::all().count() - 2, 36));
}
