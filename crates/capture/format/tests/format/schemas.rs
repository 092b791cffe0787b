//! The schemas in a capture are those of the `.proto` files.

use std::path::{Path, PathBuf};

use prost::Message as _;
use prost_types::FileDescriptorSet;

fn directory() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("proto")
}

/// The files compiled by a protobuf compiler; with `comments`, their documentation included.
fn compiled(comments: bool) -> FileDescriptorSet {
    let mut files: Vec<PathBuf> = std::fs::read_dir(directory().join("joulebus"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort();
    protox::Compiler::new([directory()])
        .unwrap()
        .include_imports(true)
        .include_source_info(comments)
        .open_files(files)
        .unwrap()
        .file_descriptor_set()
}

/// Compares a file generated from the `.proto` files with the one checked in. With
/// `JOULEBUS_WRITE_SCHEMAS` set, writes it first: to be run after a change.
fn check(path: &Path, made: &[u8]) {
    if std::env::var_os("JOULEBUS_WRITE_SCHEMAS").is_some() {
        std::fs::write(path, made).unwrap();
    }
    assert!(
        std::fs::read(path).unwrap() == made,
        "{} is stale; run again with JOULEBUS_WRITE_SCHEMAS=1",
        path.display()
    );
}

#[test]
fn the_descriptors_match_the_proto_files() {
    let path = directory().join("joulebus.binpb");
    check(&path, &compiled(false).encode_to_vec());
}

#[test]
fn the_generated_rust_messages_match_the_proto_files() {
    let made = tempfile::tempdir().unwrap();
    prost_build::Config::new()
        .out_dir(made.path())
        .compile_fds(compiled(true))
        .unwrap();
    let text = std::fs::read_to_string(made.path().join("joulebus.rs")).unwrap();
    let head = "// Generated from `proto/joulebus/*.proto`; do not edit. Written by\n\
                // `JOULEBUS_WRITE_SCHEMAS=1 cargo test -p joulebus-capture-format --test format schemas`.\n";
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/messages/proto.rs");
    check(&path, format!("{head}{text}").as_bytes());
}
