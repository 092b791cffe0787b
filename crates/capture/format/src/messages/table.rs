//! Correspondence of a struct of shared memory and a message of protobuf, by the names of fields.
//!
//! | in shared memory | in protobuf |
//! |---|---|
//! | `x` | `x`: `uint32`, `uint64`, `int64`, `fixed64`, enumeration, `optional float` or `double` |
//! | `x_unix_ns` | `x_at`, a `google.protobuf.Timestamp` |
//! | bytes `x` | `string` `x`, without the zeros at the end |
//! | an array `x` | `repeated` `x`. Zeros at the end of numbers and structs are not written |
//! | a struct `x` | a message `x` |
//! | a struct of one array | a message of its named elements, then the others, `repeated` |

use joulebus_wire::{FieldLayout, FieldType, StructLayout, layouts};
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FieldDescriptorProto};

/// Bytes of the longest varint.
pub(super) const MAX_VARINT: usize = 10;
/// Encoding of the contents of a field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Wire {
    Varint,
    Eight,
    Bytes,
    Group,
    GroupEnd,
    Four,
}

/// A struct, and the message that it is in a capture.
#[derive(Debug, Default)]
pub(super) struct Table {
    /// By their numbers, ascending.
    pub(super) fields: Vec<Field>,
    /// Positions in `fields` by number. [`NONE`] of others.
    by_number: Vec<u8>,
    /// Plain numbers by the key that they are written with.
    plain: Vec<Option<Plain>>,
    /// The struct of an empty message: omitted floats are NaN.
    pub(super) empty: Vec<u8>,
    /// Numbers that decoding keeps until the end of the message.
    pub(super) slots: usize,
    /// Maximum length of the encoding.
    pub(super) longest: usize,
}

const NONE: u8 = u8::MAX;

/// A field that is one number.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plain {
    pub(super) offset: u32,
    pub(super) of: Number,
}

#[derive(Debug)]
pub(super) struct Field {
    number: u32,
    /// Bytes before its contents, from the lowest, and their number.
    pub(super) key: (u64, usize),
    /// Name of message and field.
    pub(super) name: &'static str,
    /// Bytes from the beginning of the struct.
    pub(super) offset: usize,
    pub(super) form: Form,
}

/// Encoding of a field.
#[derive(Debug)]
pub(super) enum Form {
    /// A number, which is not written if it is 0.
    Number(Number),
    /// A float, which is always written.
    Float(Number),
    /// A timestamp of ns, always written. Seconds and ns are in two slots from this one.
    Time(usize),
    /// Numbers one after the other. How many were read is in the slot.
    Numbers { of: Number, elements: usize, slot: usize },
    /// Text of at most so many bytes.
    Text(usize),
    /// A struct, always written.
    Struct(Box<Table>),
    /// An array of structs. How many were read is in the slot.
    Structs { of: Box<Table>, elements: usize, slot: usize },
}

/// A number in shared memory and how it is encoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Number {
    /// 16 bits as a varint.
    U16,
    /// 16 bits as a signed varint.
    Code16,
    /// 32 bits as a varint.
    U32,
    /// 32 bits as a signed varint.
    Code32,
    /// 64 bits as a varint.
    U64,
    /// 64 bits as they are.
    Fixed,
    F32,
    F64,
}

impl Number {
    fn new(memory: FieldType, encoded: Type) -> Option<Self> {
        Some(match (memory, encoded) {
            (FieldType::U16, Type::Uint32) => Self::U16,
            (FieldType::U16, Type::Enum) => Self::Code16,
            (FieldType::U32, Type::Uint32) => Self::U32,
            (FieldType::U32, Type::Enum) => Self::Code32,
            (FieldType::U64, Type::Uint64) | (FieldType::I64, Type::Int64) => Self::U64,
            (FieldType::U64, Type::Fixed64) => Self::Fixed,
            (FieldType::F32, Type::Float) => Self::F32,
            (FieldType::F64, Type::Double) => Self::F64,
            _ => return None,
        })
    }

    pub(super) const fn wire(self) -> Wire {
        match self {
            Self::U16 | Self::Code16 | Self::U32 | Self::Code32 | Self::U64 => Wire::Varint,
            Self::Fixed | Self::F64 => Wire::Eight,
            Self::F32 => Wire::Four,
        }
    }

    pub(super) const fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }

    /// Bytes in shared memory.
    pub(super) const fn size(self) -> usize {
        match self {
            Self::U16 | Self::Code16 => 2,
            Self::U32 | Self::Code32 | Self::F32 => 4,
            Self::U64 | Self::Fixed | Self::F64 => 8,
        }
    }

    fn write_nan(self, into: &mut [u8]) {
        match self {
            Self::F32 => into[..4].copy_from_slice(&f32::NAN.to_ne_bytes()),
            Self::F64 => into[..8].copy_from_slice(&f64::NAN.to_ne_bytes()),
            _ => {}
        }
    }
}

/// Finds the messages that are named in a file set.
pub(super) type Find<'a> = &'a dyn Fn(&str) -> Option<DescriptorProto>;

impl Table {
    /// The table of a struct and its message. `parts` are fields of the message that are not in the
    /// struct, `lengths` fields of the struct that follow from these.
    pub(super) fn new(
        layout: &StructLayout,
        message: &DescriptorProto,
        find: Find<'_>,
        parts: &[&str],
        lengths: &[&str],
    ) -> Result<Self, String> {
        let mut slots = 0;
        let mut table = Self::within(layout, message, find, parts, lengths, &mut slots)?;
        table.slots = slots;
        Ok(table)
    }

    fn within(
        layout: &StructLayout,
        message: &DescriptorProto,
        find: Find<'_>,
        parts: &[&str],
        lengths: &[&str],
        slots: &mut usize,
    ) -> Result<Self, String> {
        let mut described: Vec<&FieldDescriptorProto> = message.field.iter().collect();
        described.retain(|field| !parts.contains(&field.name()));
        described.sort_by_key(|field| field.number());
        let elements = Elements::new(layout, &described);
        let mut left: Vec<FieldLayout> = match &elements {
            Some(elements) => elements.0.clone(),
            None => layout.fields.to_vec(),
        };
        left.retain(|field| !lengths.contains(&field.name));
        let mut table = Self { empty: vec![0; layout.size], ..Self::default() };
        for field in described {
            let counterpart = |of: &FieldLayout| {
                of.name == field.name()
                    || of.name.strip_suffix("_unix_ns") == field.name().strip_suffix("_at")
                        && field.name().ends_with("_at")
            };
            let name = format!("{}.{}", message.name(), field.name());
            let place = left.iter().position(counterpart);
            let memory = place.map(|place| left.remove(place));
            let form = memory.and_then(|memory| Some((memory, form(&memory, field, find, slots)?)));
            let Some((memory, form)) = form else {
                return Err(format!("{name} is not in {}", layout.name));
            };
            let number = field.number().unsigned_abs();
            table.add(Field {
                number,
                key: encoded(key(number, form.wire())),
                name: Box::leak(name.into_boxed_str()),
                offset: memory.offset,
                form,
            });
        }
        match left.first() {
            Some(field) => Err(format!("{}.{} is not in the message", layout.name, field.name)),
            None => Ok(table),
        }
    }

    fn add(&mut self, field: Field) {
        let number = field.number as usize;
        self.by_number.resize(self.by_number.len().max(number + 1), NONE);
        self.by_number[number] = self.fields.len() as u8;
        if let Form::Number(of) | Form::Float(of) = field.form {
            let key = key(field.number, of.wire()) as usize;
            self.plain.resize(self.plain.len().max(key + 1), None);
            let offset = field.offset as u32;
            self.plain[key] = Some(Plain { offset, of });
        }
        self.longest += field.key.1 + field.form.longest();
        let into = &mut self.empty[field.offset..];
        match &field.form {
            Form::Float(of) => of.write_nan(into),
            Form::Numbers { of, elements, .. } => {
                let all = &mut into[..elements * of.size()];
                all.chunks_mut(of.size()).for_each(|place| of.write_nan(place));
            }
            Form::Struct(table) => into[..table.empty.len()].copy_from_slice(&table.empty),
            // Unwritten ones are zeros.
            Form::Structs { .. } | Form::Number(_) | Form::Time(_) | Form::Text(_) => {}
        }
        self.fields.push(field);
    }

    /// The field of this number.
    pub(super) fn by_number(&self, number: u32) -> Option<&Field> {
        self.fields.get(usize::from(*self.by_number.get(number as usize)?))
    }

    /// The field that is written with this key, if it is one number.
    #[inline]
    pub(super) fn plain(&self, key: u32) -> Option<Plain> {
        self.plain.get(key as usize).copied().flatten()
    }
}

pub(super) const fn key(number: u32, wire: Wire) -> u32 {
    number << 3 | wire as u32
}

/// The varint of a key, from the lowest byte, and how many bytes it has.
pub(super) fn encoded(mut key: u32) -> (u64, usize) {
    let (mut word, mut bytes) = (0, 0);
    while key >= 0x80 {
        word |= u64::from(key & 0x7f | 0x80) << (8 * bytes);
        key >>= 7;
        bytes += 1;
    }
    (word | u64::from(key) << (8 * bytes), bytes + 1)
}

impl Form {
    const fn wire(&self) -> Wire {
        match self {
            Self::Number(of) | Self::Float(of) => of.wire(),
            _ => Wire::Bytes,
        }
    }

    /// Maximum length without the key.
    fn longest(&self) -> usize {
        match self {
            Self::Number(_) | Self::Float(_) => MAX_VARINT,
            Self::Time(_) => 3 * MAX_VARINT,
            Self::Numbers { elements, .. } => (1 + elements) * MAX_VARINT,
            Self::Text(bytes) => MAX_VARINT + bytes,
            Self::Struct(table) => MAX_VARINT + table.longest,
            // Each has a key.
            Self::Structs { of, elements, .. } => elements * (2 * MAX_VARINT + of.longest),
        }
    }
}

/// Encoding of a field of shared memory as a field of a message. None if there is none.
fn form(
    memory: &FieldLayout,
    field: &FieldDescriptorProto,
    find: Find<'_>,
    slots: &mut usize,
) -> Option<Form> {
    let is_repeated = field.label() == Label::Repeated;
    if memory.of == FieldType::U8 {
        let is_text = field.r#type() == Type::String && !is_repeated;
        return is_text.then_some(Form::Text(memory.size));
    }
    if is_repeated != memory.elements.is_some() {
        return None;
    }
    let elements = memory.elements.unwrap_or(1);
    let mut slot = |count| std::mem::replace(slots, *slots + count);
    if let FieldType::Struct(name) = memory.of {
        let layout = layouts().into_iter().find(|layout| layout.name == name)?;
        let message = find(field.type_name())?;
        return Some(if is_repeated {
            let of = Box::new(Table::new(&layout, &message, find, &[], &[]).ok()?);
            let slot = slot(1);
            Form::Structs { of, elements, slot }
        } else {
            let of = Table::within(&layout, &message, find, &[], &[], slots).ok()?;
            Form::Struct(Box::new(of))
        });
    }
    if field.type_name() == ".google.protobuf.Timestamp" {
        return (memory.of == FieldType::U64).then(|| Form::Time(slot(2)));
    }
    let of = Number::new(memory.of, field.r#type())?;
    if is_repeated {
        let slot = slot(1);
        return Some(Form::Numbers { of, elements, slot });
    }
    if of.is_float() {
        return field.proto3_optional().then_some(Form::Float(of));
    }
    (!field.proto3_optional()).then_some(Form::Number(of))
}

/// The elements of a struct of one array, as fields.
struct Elements(Vec<FieldLayout>);

impl Elements {
    /// None unless the message names them.
    fn new(layout: &StructLayout, described: &[&FieldDescriptorProto]) -> Option<Self> {
        let [array] = layout.fields else {
            return None;
        };
        let all = array.elements?;
        if described.iter().any(|field| field.name() == array.name) {
            return None;
        }
        let size = array.size / all;
        let (others, named): (Vec<_>, Vec<_>) =
            described.iter().partition(|field| field.label() == Label::Repeated);
        let count = named.len();
        let leak =
            |field: &FieldDescriptorProto| &*Box::leak(field.name().to_owned().into_boxed_str());
        let mut fields: Vec<FieldLayout> = named
            .into_iter()
            .enumerate()
            .map(|(place, field)| FieldLayout {
                name: leak(field),
                elements: None,
                offset: array.offset + place * size,
                size,
                ..*array
            })
            .collect();
        if let [others] = others[..]
            && count < all
        {
            fields.push(FieldLayout {
                name: leak(others),
                elements: Some(all - count),
                offset: array.offset + count * size,
                size: (all - count) * size,
                ..*array
            });
        }
        Some(Self(fields))
    }
}
