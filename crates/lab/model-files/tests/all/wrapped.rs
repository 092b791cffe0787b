//! Files that contain a pickle.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

use std::io::{Cursor, Write as _};

use zip::write::SimpleFileOptions;

const LEGACY: [&[u8]; 3] = [
    b"\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19.",
    b"\x80\x02M\xe9\x03.",
    b"\x80\x02}q\x00X\x0d\x00\x00\x00little_endianq\x01\x88s.",
];

/// An object array of NumPy that contains a pickle.
pub(crate) fn in_npy(pickle: &[u8]) -> Vec<u8> {
    let mut text = "{'descr': '|O', 'fortran_order': False, 'shape': (), }".to_owned();
    text.push_str(&" ".repeat(128 - 10 - text.len() - 1));
    text.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((text.len() as u16).to_le_bytes());
    bytes.extend(text.bytes());
    bytes.extend(pickle);
    bytes
}

/// A PyTorch file that contains a pickle.
pub(crate) fn in_zip(pickle: &[u8]) -> Vec<u8> {
    zipped(&[("archive/data.pkl", pickle), ("archive/byteorder", b"little")])
}

/// An archive of members, uncompressed.
pub(crate) fn zipped(members: &[(&str, &[u8])]) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    for (name, bytes) in members {
        archive.start_file(*name, options).unwrap();
        archive.write_all(bytes).unwrap();
    }
    archive.finish().unwrap().into_inner()
}

/// Legacy PyTorch files with the pickle at each possible position.
pub(crate) fn in_legacy(pickle: &[u8]) -> [Vec<u8>; 2] {
    let [magic, version, system] = LEGACY;
    // A complete pickle is followed by an empty list of storages.
    let keys: &[u8] = if pickle.ends_with(b".") { b"\x80\x02]." } else { b"" };
    [[magic, version, system, pickle, keys].concat(), [magic, pickle].concat()]
}
