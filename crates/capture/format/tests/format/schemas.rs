//! The schemas in a capture are those of the `.proto` files.

use std::path::{Path, PathBuf};

use prost::Message as _;
use prost_types::FileDescriptorSet;

fn directory() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("proto")
}

/// The files compiled by a protobuf compiler.
fn compiled() -> FileDescriptorSet {
    let mut files: Vec<PathBuf> = std::fs::read_dir(directory().join("joulebus"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort();
    protox::Compiler::new([directory()])
        .unwrap()
        .include_imports(true)
        .include_source_info(false)
        .open_files(files)
        .unwrap()
        .file_descriptor_set()
}

/// With `JOULEBUS_WRITE_SCHEMAS` set, writes the descriptors first: to be run after a change.
#[test]
fn the_descriptors_match_the_proto_files() {
    let (path, made) = (directory().join("joulebus.binpb"), compiled().encode_to_vec());
    if std::env::var_os("JOULEBUS_WRITE_SCHEMAS").is_some() {
        std::fs::write(&path, &made).unwrap();
    }
    assert!(
        std::fs::read(&path).unwrap() == made,
        "{} is stale; run again with JOULEBUS_WRITE_SCHEMAS=1",
        path.display()
    );
}
