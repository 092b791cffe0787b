//! Python pickles, read as data: no code in them is ever executed.
//!
//! A pickle is a program for a stack machine whose opcodes can call any Python function. This
//! machine builds plain values, and *recognises* the few calls needed for tensors and plain
//! containers without making them: [`Global`] lists them. Any other opcode or argument is refused
//! with its location, and so is any other function or class where a network could be: as the whole,
//! or with arrays in it, because skipping unknown parts could import half a model. Elsewhere, as
//! the paths and options among a checkpoint's hyperparameters, it is a [`Foreign`] value: not made,
//! and not read.
//!
//! Existing readers do not suffice: `serde-pickle` supports neither persistent ids nor arrays, and
//! the readers of candle and Burn keep unknown objects as opaque values and allocate by lengths
//! claimed in the file. This reader checks every length against the remaining bytes, holds values
//! in one flat list (so that dropping deep nesting or cycles cannot overflow the stack), and
//! creates at most [`MAX_VALUES`] of them.

mod call;
mod error;
mod opcode;
mod value;

use std::collections::HashMap;

pub(super) use call::product;
pub use error::PickleError;

pub(super) use value::{Foreign, Id, Storage, Value};

use super::element::Element;
use value::Global;

/// Maximum number of values in a pickle: a checkpoint of this network with its optimizer has a few
/// hundred.
pub(super) const MAX_VALUES: usize = 100_000;
/// Maximum length of a name in the file.
const MAX_NAME_BYTES: usize = 200;
const NEWEST_PROTOCOL: u8 = 5;

/// Places where tensors may be stored: in the pickle, or outside as PyTorch does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Storages {
    /// No.
    Inside,
    /// Yes: persistent ids name storages.
    Outside,
}

/// Values of a pickle.
#[derive(Debug)]
pub(super) struct Pickle {
    values: Vec<Value>,
    root: Id,
    /// Offset of the first byte after the pickle.
    pub(super) end: usize,
}

impl Pickle {
    /// Reads the pickle that begins at `start`. Offsets in errors count from the first of `bytes`.
    pub(super) fn read(
        bytes: &[u8],
        start: usize,
        storages: Storages,
    ) -> Result<Pickle, PickleError> {
        let mut machine = Machine {
            bytes,
            at: start,
            opcode_at: start,
            storages,
            values: Vec::new(),
            stack: Vec::new(),
            marks: Vec::new(),
            memo: HashMap::new(),
            encoded_bytes: 0,
        };
        while machine.step().map_err(|error| machine.blamed(error))? {}
        let root = machine.pop()?;
        if let Some(left) = machine.stack.len().checked_sub(1) {
            return Err(machine.refuse("STOP", format!("leaves {} values over", left + 1)));
        }
        if let Value::Foreign(foreign) = machine.value(root) {
            return Err(foreign.refused());
        }
        Ok(Pickle { values: machine.values, root, end: machine.at })
    }

    pub(super) fn root(&self) -> Id {
        self.root
    }

    pub(super) fn value(&self, id: Id) -> &Value {
        &self.values[id.0 as usize]
    }

    /// All storage references, repeated ones included.
    pub(super) fn storages(&self) -> impl Iterator<Item = &Storage> {
        self.values.iter().filter_map(|value| match value {
            Value::Storage(storage) => Some(&**storage),
            _ => None,
        })
    }
}

impl Foreign {
    /// The refusal of it.
    pub(super) fn refused(&self) -> PickleError {
        PickleError::Global { at: self.at, name: self.name.to_string() }
    }
}

/// The stack machine, without any operation that executes code.
struct Machine<'a> {
    bytes: &'a [u8],
    at: usize,
    /// Offset of the current opcode.
    opcode_at: usize,
    storages: Storages,
    values: Vec<Value>,
    stack: Vec<Id>,
    marks: Vec<usize>,
    memo: HashMap<u32, Id>,
    /// Bytes decoded from text: each text may be decoded once.
    encoded_bytes: usize,
}

impl Machine<'_> {
    /// Executes one opcode. `false` at the end of the program.
    fn step(&mut self) -> Result<bool, PickleError> {
        self.opcode_at = self.at;
        let code = self.byte("opcode")?;
        match code {
            b'.' => return Ok(false),
            0x80 => self.protocol()?,
            0x95 => _ = self.length(8, "FRAME")?,
            b'(' => self.marks.push(self.stack.len()),
            b'N' => self.push(Value::None)?,
            0x88 => self.push(Value::Bool(true))?,
            0x89 => self.push(Value::Bool(false))?,
            b'J' | b'K' | b'M' | 0x8a | b'G' => self.number(code)?,
            b'X' | 0x8c | 0x8d => self.text(code)?,
            b'B' | b'C' | 0x8e => self.raw(code)?,
            b']' => self.push(Value::List(Vec::new()))?,
            b'}' => self.push(Value::Dict(Vec::new()))?,
            b')' => self.push(Value::Tuple(Vec::new()))?,
            b't' => self.tuple_from_mark()?,
            0x85..=0x87 => self.tuple(usize::from(code - 0x84))?,
            b'a' | b'e' => self.append(code == b'e')?,
            b's' | b'u' => self.set_items(code == b'u')?,
            b'q' | b'r' | 0x94 => self.memorise(code)?,
            b'h' | b'j' => self.recall(code)?,
            b'c' | 0x93 => self.global(code)?,
            b'R' => self.reduce()?,
            0x81 => self.new_object()?,
            b'b' => self.build()?,
            b'Q' => self.storage()?,
            _ => {
                return Err(PickleError::Opcode {
                    at: self.opcode_at,
                    code,
                    name: opcode::name(code),
                });
            }
        }
        Ok(true)
    }

    /// The refusal of a foreign function before an opcode that is refused: it has more detail.
    fn blamed(&self, error: PickleError) -> PickleError {
        let foreign = self.values.iter().find_map(|value| match value {
            Value::Foreign(foreign) => Some(foreign.refused()),
            _ => None,
        });
        match error {
            PickleError::Opcode { .. } => foreign.unwrap_or(error),
            error => error,
        }
    }

    fn protocol(&mut self) -> Result<(), PickleError> {
        let found = self.byte("PROTO")?;
        if (2..=NEWEST_PROTOCOL).contains(&found) {
            Ok(())
        } else {
            Err(self.refuse("PROTO", format!("names protocol {found}, allowed: 2 to 5")))
        }
    }

    fn number(&mut self, code: u8) -> Result<(), PickleError> {
        let value = match code {
            b'J' => Value::Int(i64::from(i32::from_le_bytes(self.array("BININT")?))),
            b'K' => Value::Int(i64::from(self.byte("BININT1")?)),
            b'M' => Value::Int(i64::from(u16::from_le_bytes(self.array("BININT2")?))),
            b'G' => Value::Float(f64::from_be_bytes(self.array("BINFLOAT")?)),
            _ => {
                let count = usize::from(self.byte("LONG1")?);
                let bytes = self.take(count, "LONG1")?;
                Value::long(bytes)
            }
        };
        self.push(value)
    }

    fn text(&mut self, code: u8) -> Result<(), PickleError> {
        let (size, name) = match code {
            0x8c => (1, "SHORT_BINUNICODE"),
            b'X' => (4, "BINUNICODE"),
            _ => (8, "BINUNICODE8"),
        };
        let count = self.length(size, name)?;
        let bytes = self.take(count, name)?;
        match std::str::from_utf8(bytes) {
            Ok(text) => {
                let text = text.into();
                self.push(Value::Text(text))
            }
            Err(_) => Err(self.refuse(name, "holds text that is not UTF-8".to_owned())),
        }
    }

    fn raw(&mut self, code: u8) -> Result<(), PickleError> {
        let (size, name) = match code {
            b'C' => (1, "SHORT_BINBYTES"),
            b'B' => (4, "BINBYTES"),
            _ => (8, "BINBYTES8"),
        };
        let count = self.length(size, name)?;
        let bytes = self.take(count, name)?.into();
        self.push(Value::Bytes(bytes))
    }

    fn tuple_from_mark(&mut self) -> Result<(), PickleError> {
        let items = self.pop_to_mark("TUPLE")?;
        self.push(Value::Tuple(items))
    }

    fn tuple(&mut self, count: usize) -> Result<(), PickleError> {
        let floor = self.floor();
        let Some(first) = self.stack.len().checked_sub(count).filter(|&at| at >= floor) else {
            return Err(self.stack_empty());
        };
        let items = self.stack.split_off(first);
        self.push(Value::Tuple(items))
    }

    fn append(&mut self, many: bool) -> Result<(), PickleError> {
        let items = if many { self.pop_to_mark("APPENDS")? } else { vec![self.pop()?] };
        let list = self.top()?;
        match &mut self.values[list.0 as usize] {
            Value::List(all) | Value::Foreign(Foreign { parts: all, .. }) => {
                all.extend(items);
                Ok(())
            }
            other => {
                let found = other.kind();
                Err(self.refuse("APPEND", format!("appends to {found}, allowed: a list")))
            }
        }
    }

    fn set_items(&mut self, many: bool) -> Result<(), PickleError> {
        let items = if many {
            self.pop_to_mark("SETITEMS")?
        } else {
            let value = self.pop()?;
            vec![self.pop()?, value]
        };
        let dict = self.top()?;
        let (pairs, over) = items.as_chunks::<2>();
        if !over.is_empty() {
            return Err(self.refuse("SETITEMS", "has a key without a value".to_owned()));
        }
        match &mut self.values[dict.0 as usize] {
            Value::Dict(all) => {
                all.extend(pairs.iter().map(|&[key, value]| (key, value)));
                Ok(())
            }
            Value::Foreign(foreign) => {
                foreign.parts.extend(items);
                Ok(())
            }
            other => {
                let found = other.kind();
                Err(self.refuse("SETITEM", format!("sets an item of {found}, allowed: a dict")))
            }
        }
    }

    fn memorise(&mut self, code: u8) -> Result<(), PickleError> {
        let index = match code {
            b'q' => u32::from(self.byte("BINPUT")?),
            b'r' => u32::from_le_bytes(self.array("LONG_BINPUT")?),
            // Never more entries than values, which are fewer than this.
            _ => self.memo.len() as u32,
        };
        let id = self.top()?;
        self.memo.insert(index, id);
        if self.memo.len() > MAX_VALUES {
            return Err(self.too_many());
        }
        Ok(())
    }

    fn recall(&mut self, code: u8) -> Result<(), PickleError> {
        let index = match code {
            b'h' => u32::from(self.byte("BINGET")?),
            _ => u32::from_le_bytes(self.array("LONG_BINGET")?),
        };
        let Some(&id) = self.memo.get(&index) else {
            let name = opcode::name(code);
            return Err(self.refuse(name, format!("takes entry {index}, which was never stored")));
        };
        self.push_id(id)
    }

    fn global(&mut self, code: u8) -> Result<(), PickleError> {
        let (module, name) = if code == b'c' {
            (self.line()?, self.line()?)
        } else {
            let (name, module) = (self.pop()?, self.pop()?);
            match (self.value(module), self.value(name)) {
                (Value::Text(module), Value::Text(name)) => (module.to_string(), name.to_string()),
                _ => return Err(self.refuse("STACK_GLOBAL", "has names that are not text".into())),
            }
        };
        match Global::known(&module, &name) {
            Some(global) => self.push(Value::Global(global)),
            None => self.push(Value::Foreign(Foreign {
                at: self.opcode_at,
                name: error::shown(&format!("{module}.{name}")).into(),
                parts: Vec::new(),
            })),
        }
    }

    /// A name up to the end of its line.
    fn line(&mut self) -> Result<String, PickleError> {
        let rest = &self.bytes[self.at..];
        let rest = &rest[..rest.len().min(MAX_NAME_BYTES)];
        let Some(length) = rest.iter().position(|byte| *byte == b'\n') else {
            let needs = (self.bytes.len() - self.at) as u64 + 1;
            return Err(if rest.len() < MAX_NAME_BYTES {
                self.truncated("GLOBAL", needs)
            } else {
                self.refuse("GLOBAL", format!("has a name longer than {MAX_NAME_BYTES} bytes"))
            });
        };
        let line = self.take(length + 1, "GLOBAL")?;
        Ok(String::from_utf8_lossy(&line[..length]).into_owned())
    }

    fn value(&self, id: Id) -> &Value {
        &self.values[id.0 as usize]
    }

    fn push(&mut self, value: Value) -> Result<(), PickleError> {
        let id = self.add(value)?;
        self.push_id(id)
    }

    fn push_id(&mut self, id: Id) -> Result<(), PickleError> {
        if self.stack.len() >= MAX_VALUES {
            return Err(self.too_many());
        }
        self.stack.push(id);
        Ok(())
    }

    fn add(&mut self, value: Value) -> Result<Id, PickleError> {
        if self.values.len() >= MAX_VALUES {
            return Err(self.too_many());
        }
        self.values.push(value);
        Ok(Id(self.values.len() as u32 - 1))
    }

    /// Stack items below this index belong to the context before the last mark.
    fn floor(&self) -> usize {
        self.marks.last().copied().unwrap_or(0)
    }

    fn pop(&mut self) -> Result<Id, PickleError> {
        if self.stack.len() <= self.floor() {
            return Err(self.stack_empty());
        }
        self.stack.pop().ok_or_else(|| self.stack_empty())
    }

    fn top(&self) -> Result<Id, PickleError> {
        let top = self.stack.get(self.floor()..).and_then(<[Id]>::last);
        top.copied().ok_or_else(|| self.stack_empty())
    }

    fn pop_to_mark(&mut self, name: &'static str) -> Result<Vec<Id>, PickleError> {
        match self.marks.pop() {
            Some(mark) => Ok(self.stack.split_off(mark)),
            None => Err(self.refuse(name, "has no MARK before it".to_owned())),
        }
    }

    fn byte(&mut self, name: &'static str) -> Result<u8, PickleError> {
        Ok(self.array::<1>(name)?[0])
    }

    fn array<const N: usize>(&mut self, name: &'static str) -> Result<[u8; N], PickleError> {
        let bytes = self.take(N, name)?;
        let mut array = [0; N];
        array.copy_from_slice(bytes);
        Ok(array)
    }

    /// A length of `size` bytes, checked against the bytes left.
    fn length(&mut self, size: usize, name: &'static str) -> Result<usize, PickleError> {
        let bytes = self.take(size, name)?;
        let length = bytes.iter().rev().fold(0_u64, |length, byte| length << 8 | u64::from(*byte));
        let left = self.bytes.len() - self.at;
        match usize::try_from(length) {
            Ok(length) if length <= left => Ok(length),
            _ => Err(self.truncated(name, length)),
        }
    }

    fn take(&mut self, count: usize, name: &'static str) -> Result<&[u8], PickleError> {
        let left = self.bytes.len().saturating_sub(self.at);
        if count > left {
            return Err(self.truncated(name, count as u64));
        }
        let start = self.at;
        self.at += count;
        Ok(&self.bytes[start..self.at])
    }

    fn truncated(&self, opcode: &'static str, needs: u64) -> PickleError {
        PickleError::Truncated {
            at: self.opcode_at,
            opcode,
            needs,
            left: self.bytes.len().saturating_sub(self.at),
        }
    }

    fn stack_empty(&self) -> PickleError {
        let code = self.bytes.get(self.opcode_at).copied().unwrap_or_default();
        self.refuse(opcode::name(code), "needs more values than there are".to_owned())
    }

    fn too_many(&self) -> PickleError {
        PickleError::TooMany { at: self.opcode_at, allowed: MAX_VALUES }
    }

    fn refuse(&self, opcode: &'static str, detail: String) -> PickleError {
        PickleError::Program { at: self.opcode_at, opcode, detail }
    }
}
