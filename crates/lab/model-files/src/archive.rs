//! Zip archives, the containers of `.npz` and `.pt` files.

use std::io::{Cursor, Read as _, Write as _};

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipArchive, ZipWriter};

use super::{Container, ReadError};

pub(super) const MAGIC: &[u8] = b"PK\x03\x04";
/// Maximum number of members: a checkpoint has one for each tensor.
const MAX_MEMBERS: usize = 4_096;
/// Maximum size of all members, after decompression.
const MAX_BYTES: u64 = 32 << 20;
/// End of central directory record. Its fields at 8 and 10 count the members.
const END: &[u8] = b"PK\x05\x06";
/// The ZIP64 record, for archives of more than 4 GiB. Its fields at 24 and 32 count the members.
/// PyTorch always writes it.
const END_64: &[u8] = b"PK\x06\x06";

/// A member of an archive.
pub(super) struct Member {
    pub(super) name: String,
    pub(super) bytes: Vec<u8>,
}

/// All members, in the order of the archive. Checksums are checked.
pub(super) fn read(container: Container, bytes: &[u8]) -> Result<Vec<Member>, ReadError> {
    let part = |part: String, detail: String| ReadError::Part { container, part, detail };
    check_counts(container, bytes)?;
    let damaged =
        |place: &str, error: &dyn std::fmt::Display| part(place.to_owned(), error.to_string());
    let directory = format!("directory, somewhere in {} bytes", bytes.len());
    let mut archive =
        ZipArchive::new(Cursor::new(bytes)).map_err(|error| damaged(&directory, &error))?;
    let mut members = Vec::new();
    let mut left = MAX_BYTES;
    for index in 0..archive.len() {
        let place = format!("member {index}");
        let member = archive.by_index(index).map_err(|error| damaged(&place, &error))?;
        let name = member.name().map_err(|error| damaged(&place, &error))?;
        let name = name.into_owned();
        let place = format!("member {name:?}");
        let mut content = Vec::new();
        let read = member.take(left + 1).read_to_end(&mut content);
        read.map_err(|error| damaged(&place, &error))?;
        left = left
            .checked_sub(content.len() as u64)
            .ok_or_else(|| part(place, format!("the members have more than {MAX_BYTES} bytes")))?;
        members.push(Member { name, bytes: content });
    }
    Ok(members)
}

/// Names an archive that has neither a pickle of PyTorch nor arrays, and the way to save its model.
pub(super) fn foreign(members: &[Member]) -> Option<String> {
    let has = |name: &str| {
        let mut members = members.iter();
        members.any(|member| member.name == name || member.name.ends_with(&format!("/{name}")))
    };
    let other = members.iter().find(|member| !member.name.ends_with(".npy"));
    Some(if has("model.weights.h5") || has("keras_metadata.pb") {
        "found a model of Keras. Save its arrays: `numpy.savez('model.npz', *model.get_weights())`"
            .to_owned()
    } else if has("archive_format")
        || has("models/model.json")
        || has("serialized_exported_program.json")
    {
        "found an exported program of PyTorch (.pt2). Save its arrays: \
         `torch.save(torch.export.load('FILE').state_dict, 'model.pt')`"
            .to_owned()
    } else if has("data.pkl") {
        return None;
    } else {
        format!("found a zip archive with {:?}", other?.name)
    })
}

/// Refuses counts that no archive of this size has, before memory for the members is allocated.
fn check_counts(container: Container, bytes: &[u8]) -> Result<(), ReadError> {
    for (mark, at, size) in [(END, 8, 2), (END, 10, 2), (END_64, 24, 8), (END_64, 32, 8)] {
        let places = bytes.windows(mark.len()).enumerate();
        for (start, _) in places.filter(|(_, window)| *window == mark) {
            let field = bytes.get(start + at..start + at + size).unwrap_or_default();
            let count = field.iter().rev().fold(0_u64, |count, byte| count << 8 | u64::from(*byte));
            // 65535 refers to the ZIP64 record.
            if count > MAX_MEMBERS as u64 && count != u64::from(u16::MAX) {
                return Err(ReadError::Part {
                    container,
                    part: format!("directory, byte {}", start + at),
                    detail: format!("found {count} members, allowed: {MAX_MEMBERS}"),
                });
            }
        }
    }
    Ok(())
}

/// An uncompressed archive of these members. Deterministic.
pub(super) fn write(members: &[(String, Vec<u8>)]) -> Result<Vec<u8>, zip::result::ZipError> {
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Stored)
        .last_modified_time(DateTime::default());
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in members {
        archive.start_file(name.as_str(), options)?;
        archive.write_all(bytes)?;
    }
    Ok(archive.finish()?.into_inner())
}
