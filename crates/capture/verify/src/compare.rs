//! Compares recorded with computed payloads, field by field, bit for bit.

use std::fmt;

use bytemuck::bytes_of;
use joulebus_wire::{DropReason, FieldLayout, FieldType, Row};

/// Interpretation of a field's bits.
#[derive(Debug, Clone, Copy)]
enum Form {
    Unsigned,
    Signed,
    Single,
    Double,
}

/// A field's value, as its bits.
#[derive(Debug, Clone, Copy)]
pub struct Value {
    bits: u64,
    form: Form,
}

impl Value {
    /// The number in a field of shared memory.
    fn new(field: FieldType, bytes: &[u8]) -> Self {
        let mut word = [0; 8];
        let count = bytes.len().min(word.len());
        word[..count].copy_from_slice(&bytes[..count]);
        let form = match field {
            FieldType::I64 => Form::Signed,
            FieldType::F32 => Form::Single,
            FieldType::F64 => Form::Double,
            _ => Form::Unsigned,
        };
        let bits = u64::from_le_bytes(word);
        Self { bits, form }
    }

    /// Converts it to a number. Not exact beyond 2^53.
    pub fn number(self) -> f64 {
        match self.form {
            Form::Unsigned => self.bits as f64,
            Form::Signed => self.bits.cast_signed() as f64,
            Form::Single => f32::from_bits(self.bits as u32).into(),
            Form::Double => f64::from_bits(self.bits),
        }
    }
}

impl From<u64> for Value {
    fn from(bits: u64) -> Self {
        let form = Form::Unsigned;
        Self { bits, form }
    }
}

impl From<f32> for Value {
    fn from(value: f32) -> Self {
        Self { bits: value.to_bits().into(), form: Form::Single }
    }
}

impl fmt::Display for Value {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.form {
            Form::Unsigned => write!(out, "{}", self.bits),
            Form::Signed => write!(out, "{}", self.bits.cast_signed()),
            // A float is written so that it parses to the same bits. A NaN's bits are shown.
            Form::Single => match f32::from_bits(self.bits as u32) {
                nan if nan.is_nan() => write!(out, "NaN ({:08x})", self.bits),
                value => write!(out, "{value:?}"),
            },
            Form::Double => match f64::from_bits(self.bits) {
                nan if nan.is_nan() => write!(out, "NaN ({:016x})", self.bits),
                value => write!(out, "{value:?}"),
            },
        }
    }
}

/// A field that differs: name, recorded value, computed value.
pub(super) type FieldDifference = (&'static str, Value, Value);

/// Takes a field that differs, and the robot that it concerns, if that is not the row's.
pub(super) type Differs<'a> = &'a mut dyn FnMut(Option<u32>, FieldDifference);

/// Calls `differs` for each field whose bits differ. `only` these, or all. Arrays come last.
pub(super) fn fields<T: Row>(
    recorded: &T,
    computed: &T,
    only: Option<&[&str]>,
    differs: Differs<'_>,
) {
    let (recorded, computed) = (bytes_of(recorded), bytes_of(computed));
    if recorded == computed {
        return;
    }
    let is_array =
        |field: &FieldLayout| field.elements.is_some() || matches!(field.of, FieldType::Struct(_));
    for arrays in [false, true] {
        let fields = T::LAYOUT.fields.iter();
        for field in fields.filter(|field| is_array(field) == arrays) {
            if only.is_none_or(|only| only.contains(&field.name)) {
                let at = field.offset..field.offset + field.size;
                values(field, &recorded[at.clone()], &computed[at], differs);
            }
        }
    }
}

fn values(field: &FieldLayout, recorded: &[u8], computed: &[u8], differs: Differs<'_>) {
    let size = match field.of {
        FieldType::Struct("DropCounts") => 8,
        _ => field.size / field.elements.unwrap_or(1),
    };
    let pairs = recorded.chunks_exact(size).zip(computed.chunks_exact(size));
    for (place, (recorded, computed)) in pairs.enumerate() {
        if recorded == computed {
            continue;
        }
        match field.of {
            FieldType::Struct("DropCounts") => {
                let reason = DropReason::ALL.get(place);
                let name = reason.map_or(field.name, |reason| reason.name());
                let value = |bytes| Value::new(FieldType::U64, bytes);
                differs(None, (name, value(recorded), value(computed)));
            }
            // It begins with the robot.
            FieldType::Struct("Refusal") => {
                let value = |bytes| Value::new(FieldType::U32, bytes);
                let (was, is) = (value(recorded), value(computed));
                differs(Some(is.bits as u32), ("refused robots", was, is));
            }
            of => differs(None, (field.name, Value::new(of, recorded), Value::new(of, computed))),
        }
    }
}
