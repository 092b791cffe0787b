//! Schemas in a capture: a file set of protobuf descriptors with all imports.

use joulebus_wire::{Channel, FieldLayout, FieldRole, FieldType, Row, StructLayout, layouts};
use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet,
    OneofDescriptorProto,
};

/// Compiled from `proto/joulebus/*.proto`. A test compiles it again.
const DESCRIPTORS: &[u8] = include_bytes!("../../proto/joulebus.binpb");
/// The field of the rows in a derived message, at least.
const ROWS: i32 = 30;

/// The files of this crate.
pub(super) fn all() -> FileDescriptorSet {
    // Ours, and tested. Without it, messages have no schema.
    FileDescriptorSet::decode(DESCRIPTORS).unwrap_or_default()
}

/// The files in which a channel's message is: those of this crate, or one that is derived from its
/// layout.
pub(super) fn set_of<C: Channel>() -> FileDescriptorSet {
    let all = all();
    match message(&all, C::MESSAGE) {
        Some(_) => all,
        None => FileDescriptorSet { file: vec![derived::<C>()] },
    }
}

/// The files that declare a message of the channel, imports first.
pub(super) fn files_of<C: Channel>(message: &str) -> Vec<u8> {
    files(&set_of::<C>(), message)
}

/// The files of this crate that declare a message, imports first.
pub(super) fn files_of_ours(message: &str) -> Vec<u8> {
    files(&all(), message)
}

fn files(all: &FileDescriptorSet, message: &str) -> Vec<u8> {
    let mut file = Vec::new();
    let declaring = all.file.iter().find(|file| declared(file, message).is_some());
    if let Some(declaring) = declaring {
        gather(all, declaring.name(), &mut file);
    }
    FileDescriptorSet { file }.encode_to_vec()
}

/// The message of a name, with or without its package.
pub(super) fn message(set: &FileDescriptorSet, name: &str) -> Option<DescriptorProto> {
    let name = name.strip_prefix(".joulebus.").unwrap_or(name);
    set.file.iter().find_map(|file| declared(file, name)).cloned()
}

fn declared<'a>(file: &'a FileDescriptorProto, name: &str) -> Option<&'a DescriptorProto> {
    let mut messages = file.message_type.iter();
    messages.find(|message| file.package() == "joulebus" && message.name() == name)
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

/// Describes a channel that is declared elsewhere: fields are numbered in the order of memory, so
/// that later ones are added at the end of a struct. Hashes, instants and runs are `fixed64`,
/// floats `optional`, and rows come last.
fn derived<C: Channel>() -> FileDescriptorProto {
    let (header, row) = (<C::Header as Row>::LAYOUT, <C::Row as Row>::LAYOUT);
    let mut messages = Vec::new();
    let mut frame = describe(&header, C::MESSAGE, &mut messages);
    let number = ROWS.max(frame.field.len() as i32 + 1);
    let is_bytes = row.fields.is_empty();
    let kind = if is_bytes { Type::Bytes } else { Type::Message };
    let label = if is_bytes { Label::Optional } else { Label::Repeated };
    frame.field.push(FieldDescriptorProto {
        type_name: (!is_bytes).then(|| format!(".joulebus.{}", row.name)),
        ..plain("rows", number, kind, label)
    });
    if !is_bytes {
        let row = describe(&row, row.name, &mut messages);
        messages.push(row);
    }
    messages.push(frame);
    FileDescriptorProto {
        name: Some(format!("joulebus/{}.proto", C::SERVICE.name())),
        package: Some("joulebus".to_owned()),
        syntax: Some("proto3".to_owned()),
        message_type: messages,
        ..FileDescriptorProto::default()
    }
}

fn plain(name: &str, number: i32, kind: Type, label: Label) -> FieldDescriptorProto {
    FieldDescriptorProto {
        name: Some(name.to_owned()),
        number: Some(number),
        r#type: Some(kind.into()),
        label: Some(label.into()),
        ..FieldDescriptorProto::default()
    }
}

/// The message of a struct. Those of structs within it are added to `messages`.
fn describe(
    layout: &StructLayout,
    name: &str,
    messages: &mut Vec<DescriptorProto>,
) -> DescriptorProto {
    let mut message = DescriptorProto { name: Some(name.to_owned()), ..DescriptorProto::default() };
    for (field, number) in layout.fields.iter().zip(1..) {
        let label = match field.elements {
            // An array of bytes is text.
            Some(_) if field.of != FieldType::U8 => Label::Repeated,
            _ => Label::Optional,
        };
        let kind = kind(field);
        let mut described = plain(field.name, number, kind, label);
        if let FieldType::Struct(name) = field.of {
            described.type_name = Some(format!(".joulebus.{name}"));
            let known = messages.iter().any(|message| message.name() == name);
            let inner = layouts().into_iter().find(|layout| layout.name == name && !known);
            if let Some(inner) = inner {
                let inner = describe(&inner, name, messages);
                messages.push(inner);
            }
        }
        if label == Label::Optional && matches!(kind, Type::Float | Type::Double) {
            described.proto3_optional = Some(true);
            described.oneof_index = Some(message.oneof_decl.len() as i32);
            message.oneof_decl.push(OneofDescriptorProto {
                name: Some(format!("_{}", field.name)),
                ..OneofDescriptorProto::default()
            });
        }
        message.field.push(described);
    }
    message
}

fn kind(field: &FieldLayout) -> Type {
    let is_spread = field.role != FieldRole::Value || field.name.ends_with("_hash");
    match field.of {
        FieldType::U8 => Type::String,
        FieldType::U16 | FieldType::U32 => Type::Uint32,
        FieldType::U64 if is_spread => Type::Fixed64,
        FieldType::U64 => Type::Uint64,
        FieldType::I64 => Type::Int64,
        FieldType::F32 => Type::Float,
        FieldType::F64 => Type::Double,
        // Those that are added later must be described here as well.
        _ => Type::Message,
    }
}
