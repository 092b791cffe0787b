//! Schemas in a capture: a file set of protobuf descriptors with all imports.

use prost::Message as _;
use joulebus_wire::Channel;
use prost_types::{DescriptorProto, FileDescriptorProto, FileDescriptorSet};

/// Compiled from `proto/joulebus/*.proto`; a test compiles it again.
const DESCRIPTORS: &[u8] = include_bytes!("../../proto/joulebus.binpb");

/// The files that declare the message `name` (`joulebus.Samples`), imports first. Empty for a name
/// that is not ours.
pub(crate) fn descriptors(name: &str) -> Vec<u8> {
    // Ours, and tested; without it, messages have no schema.
    let all = FileDescriptorSet::decode(DESCRIPTORS).unwrap_or_default();
    let short = name.strip_prefix("joulebus.").unwrap_or(name);
    let declares = |file: &&FileDescriptorProto| {
        let mut messages = file.message_type.iter();
        file.package() == "joulebus" && messages.any(|message| message.name() == short)
    };
    let mut file = Vec::new();
    if let Some(declaring) = all.file.iter().find(declares) {
        gather(&all, declaring.name(), &mut file);
    }
    FileDescriptorSet { file }.encode_to_vec()
}

fn gather(all: &FileDescriptorSet, name: &str, found: &mut Vec<FileDescriptorProto>) {
    if found.iter().any(|file| file.name() == name) {
        return;
    }
    if let Some(file) = all.file.iter().find(|file| file.name() == name) {
        for imported in &file.dependency {
            gather(all, imported, found);
        }
        found.push(file.clone());
    }
}

/// The files that declare the message of a channel.
pub(super) fn set_of<C: Channel>() -> FileDescriptorSet {
    FileDescriptorSet::decode(DESCRIPTORS).unwrap_or_default()
}

/// The message of a name, with or without its package.
pub(super) fn message(set: &FileDescriptorSet, name: &str) -> Option<DescriptorProto> {
    let name = name.strip_prefix(".joulebus.").unwrap_or(name);
    let mut messages = set.file.iter().flat_map(|file| &file.message_type);
    messages.find(|message| message.name() == name).cloned()
}
