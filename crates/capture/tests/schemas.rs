//! The schemas that go into a capture are those of the `.proto` files, and say what is written.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on ends")]

use std::path::{Path, PathBuf};

use prost::Message as _;
use prost_types::FileDescriptorSet;

fn directory() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("proto")
}

/// What a protobuf compiler makes of the files.
fn compiled() -> FileDescriptorSet {
    let mut files: Vec<PathBuf> = std::fs::read_dir(directory().join("joulebus"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort();
    protox::Compiler::new([directory()])
        .unwrap()
        .include_imports(true)
        .open_files(files)
        .unwrap()
        .file_descriptor_set()
}

/// With `JOULEBUS_WRITE_DESCRIPTORS` set, writes it instead: to be run after a change to a file.
#[test]
fn the_descriptors_are_those_of_the_files() {
    let path = directory().join("joulebus.binpb");
    let compiled = compiled().encode_to_vec();
    if std::env::var_os("JOULEBUS_WRITE_DESCRIPTORS").is_some() {
        std::fs::write(&path, &compiled).unwrap();
    }
    assert!(
        std::fs::read(&path).unwrap() == compiled,
        "run again with JOULEBUS_WRITE_DESCRIPTORS=1"
    );
}
