//! Files to corrupt, and the guarantees of every recovery.

use std::collections::BTreeMap;
use std::io::Cursor;

use joulebus_capture_format::Reader;
use joulebus_capture_format::inspect::inspect;
use joulebus_capture_format::recover::{RECOVERED, Recovery, recover};
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, Compression, WriteOptions};

/// Messages in every file.
pub(crate) const MESSAGES: u64 = 40;

/// Format options of a file.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FileKind {
    pub name: &'static str,
    pub chunks: bool,
    pub compression: Option<Compression>,
    pub summary: bool,
}

pub(crate) const KINDS: [FileKind; 5] = [
    FileKind { name: "plain chunks", chunks: true, compression: None, summary: true },
    FileKind { name: "zstd", chunks: true, compression: Some(Compression::Zstd), summary: true },
    FileKind { name: "lz4", chunks: true, compression: Some(Compression::Lz4), summary: true },
    FileKind { name: "no chunks", chunks: false, compression: None, summary: true },
    FileKind { name: "no summary", chunks: true, compression: None, summary: false },
];

pub(crate) fn file(kind: FileKind) -> Vec<u8> {
    let mut writer = WriteOptions::new()
        .use_chunks(kind.chunks)
        .chunk_size(Some(400))
        .compression(kind.compression)
        .emit_statistics(kind.summary)
        .emit_summary_records(kind.summary)
        .create(Cursor::new(Vec::new()))
        .unwrap();
    let config = Attachment {
        log_time: 1,
        create_time: 2,
        name: "config.toml".to_owned(),
        media_type: "application/toml".to_owned(),
        data: b"[fleet]\nname = \"small\"\n".into(),
    };
    writer.attach(&config).unwrap();
    let schema = writer.add_schema("a.B", "protobuf", b"not really one").unwrap();
    let channels: Vec<u16> = ["a", "b"]
        .iter()
        .map(|topic| writer.add_channel(schema, topic, "protobuf", &BTreeMap::new()).unwrap())
        .collect();
    for number in 0..MESSAGES {
        let header = MessageHeader {
            channel_id: channels[usize::from(number % 3 == 0)],
            sequence: u32::try_from(number).unwrap(),
            log_time: 1_000 + number * 33,
            publish_time: 1_000 + number * 33,
        };
        let data: Vec<u8> = (0..20 + number).map(|at| (at * number) as u8).collect();
        writer.write_to_known_channel(&header, &data).unwrap();
    }
    let metadata = Metadata {
        name: "build".to_owned(),
        metadata: BTreeMap::from([("version".to_owned(), "0".to_owned())]),
    };
    writer.write_metadata(&metadata).unwrap();
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

/// Reads like a replay: to the first error, and never beyond the file.
pub(crate) fn read(bytes: &[u8]) -> u64 {
    let Ok(mut reader) = Reader::new(Cursor::new(bytes)) else {
        return 0;
    };
    let mut messages = 0;
    while let Ok(Some(_)) = reader.next_entry() {
        messages += 1;
    }
    messages
}

/// Recovers, and checks the guarantees of every result.
pub(crate) fn recovered(bytes: &[u8], what: &str) -> Option<Recovery> {
    let (recovery, result) = match recover(Cursor::new(bytes), Cursor::new(Vec::new())) {
        Ok(done) => done,
        Err(error) => {
            assert!(error.to_string().contains("byte 0"), "{what}: {error}");
            return None;
        }
    };
    let written = result.into_inner();
    let result = inspect(Cursor::new(&written)).unwrap();
    assert!(result.is_sound() && result.complete, "{what}: {:?}", result.findings);
    assert_eq!(result.messages, recovery.messages.recovered, "{what}");
    // What other readers find by its indexes.
    let summary = mcap::Summary::read(&written).unwrap().unwrap();
    assert_eq!(summary.stats.unwrap().message_count, result.messages, "{what}");
    let chunks: u64 = result.chunks.iter().map(|chunks| chunks.chunks).sum();
    assert_eq!(summary.chunk_indexes.len() as u64, chunks, "{what}");
    assert_eq!(result.attachment_count, recovery.attachments.recovered, "{what}");
    let note = u64::from(!recovery.is_clean());
    assert_eq!(result.metadata_count, recovery.metadata.recovered + note, "{what}");
    if note == 1 {
        assert!(result.metadata.iter().any(|metadata| metadata.name == RECOVERED));
    }
    Some(recovery)
}
