//! The recognised calls for tensors and plain containers, replaced by their results.

use super::value::{Array, DType, Foreign, Global, Storage, Tensor};
use super::{Element, Id, Machine, PickleError, Storages, Value};

/// Maximum number of arguments of a call.
const MAX_ARGUMENTS: usize = 8;
/// Maximum number of dimensions of an array.
const MAX_DIMENSIONS: usize = 8;

impl Foreign {
    /// The object that a call of the function would make.
    fn made_of(&self, function: Id, arguments: Id) -> Foreign {
        Foreign { at: self.at, name: self.name.clone(), parts: vec![function, arguments] }
    }
}

impl Machine<'_> {
    /// REDUCE: a function call.
    pub(super) fn reduce(&mut self) -> Result<(), PickleError> {
        let (arguments, function) = (self.pop()?, self.pop()?);
        if let Value::Foreign(foreign) = self.value(function) {
            let made = foreign.made_of(function, arguments);
            return self.push(Value::Foreign(made));
        }
        let (global, arguments) = self.function("REDUCE", function, arguments)?;
        let result = match (global, arguments.as_slice()) {
            (Global::OrderedDict, []) => self.add(Value::Dict(Vec::new()))?,
            (Global::Set | Global::Size, &[items]) => self.items_of(items)?,
            (Global::Encode, &[text, encoding]) => self.encode(text, encoding)?,
            (Global::Reconstruct, &[class, _, _]) => self.reconstruct(class)?,
            (Global::DType, &[code, ..]) => self.dtype(code)?,
            (Global::Scalar, &[dtype, bytes]) => self.scalar(dtype, bytes)?,
            (Global::RebuildTensor, &[storage, offset, shape, strides, ..]) => {
                self.tensor(storage, offset, shape, strides)?
            }
            (Global::RebuildParameter, &[tensor, ..]) => tensor,
            _ => {
                let found = arguments.len();
                return Err(self.wrong(global, format!("does not take {found} arguments")));
            }
        };
        self.push_id(result)
    }

    /// NEWOBJ: a class without its attributes, which BUILD sets.
    pub(super) fn new_object(&mut self) -> Result<(), PickleError> {
        let (arguments, class) = (self.pop()?, self.pop()?);
        if let Value::Foreign(foreign) = self.value(class) {
            let made = foreign.made_of(class, arguments);
            return self.push(Value::Foreign(made));
        }
        match self.function("NEWOBJ", class, arguments)? {
            (Global::Layer(class), arguments) if arguments.is_empty() => {
                let attributes = None;
                self.push(Value::Layer { class, attributes })
            }
            (Global::OrderedDict, arguments) if arguments.is_empty() => {
                self.push(Value::Dict(Vec::new()))
            }
            (global, _) => {
                Err(self.wrong(global, "is not a class that is created this way".to_owned()))
            }
        }
    }

    /// BUILD: the state of the object just created.
    pub(super) fn build(&mut self) -> Result<(), PickleError> {
        let (state, object) = (self.pop()?, self.top()?);
        if let Value::Foreign(foreign) = &mut self.values[object.0 as usize] {
            foreign.parts.push(state);
            return Ok(());
        }
        let built = match (self.value(object), self.value(state)) {
            (Value::BlankArray, Value::Tuple(state)) => self.array_from(state)?,
            (Value::DType(dtype), Value::Tuple(state)) => {
                let dtype = *dtype;
                let order = state.get(1).map(|&order| self.value(order));
                match order {
                    Some(Value::Text(order)) => {
                        Value::DType(DType { big_endian: &**order == ">", ..dtype })
                    }
                    _ => return Err(self.wrong(Global::DType, "has no byte order".to_owned())),
                }
            }
            // Attributes of a dict, such as the versions of a state dict's layers, are irrelevant.
            (Value::Dict(_), Value::Dict(_)) => return Ok(()),
            (&Value::Layer { class, .. }, Value::Dict(_)) => {
                Value::Layer { class, attributes: Some(state) }
            }
            (object, state) => {
                let (object, state) = (object.kind(), state.kind());
                return Err(self.refuse("BUILD", format!("gives {state} to {object}")));
            }
        };
        self.values[object.0 as usize] = built;
        Ok(())
    }

    /// BINPERSID: a storage outside of the pickle.
    pub(super) fn storage(&mut self) -> Result<(), PickleError> {
        if self.storages == Storages::Inside {
            let detail = "names a storage outside of a file that has none";
            return Err(self.refuse("BINPERSID", detail.to_owned()));
        }
        let id = self.pop()?;
        let parts = match self.value(id) {
            Value::Tuple(parts) => parts.as_slice(),
            _ => &[],
        };
        let parts = parts.iter().map(|&part| self.value(part));
        let parts: Vec<&Value> = parts.collect();
        let storage = match parts.as_slice() {
            [
                Value::Text(kind),
                Value::Global(Global::Storage(element)),
                Value::Text(key),
                Value::Text(_),
                Value::Int(count),
            ]
            | [
                Value::Text(kind),
                Value::Global(Global::Storage(element)),
                Value::Text(key),
                Value::Text(_),
                Value::Int(count),
                Value::None,
            ] if &**kind == "storage" => usize::try_from(*count).ok().map(|count| Storage {
                element: *element,
                key: key.clone(),
                count,
            }),
            _ => None,
        };
        match storage {
            Some(storage) => self.push(Value::Storage(Box::new(storage))),
            None => {
                let detail = "names something other than ('storage', class, key, device, length)";
                Err(self.refuse("BINPERSID", detail.to_owned()))
            }
        }
    }

    /// A recognised function with its arguments.
    fn function(
        &self,
        opcode: &'static str,
        function: Id,
        arguments: Id,
    ) -> Result<(Global, Vec<Id>), PickleError> {
        match (self.value(function), self.value(arguments)) {
            (&Value::Global(global), Value::Tuple(arguments))
                if arguments.len() <= MAX_ARGUMENTS =>
            {
                Ok((global, arguments.clone()))
            }
            (function, arguments) => {
                let (function, arguments) = (function.kind(), arguments.kind());
                let detail = format!(
                    "calls {function} with {arguments}, allowed: a known function with \
                     at most {MAX_ARGUMENTS} arguments"
                );
                Err(self.refuse(opcode, detail))
            }
        }
    }

    fn items_of(&self, items: Id) -> Result<Id, PickleError> {
        match self.value(items) {
            Value::List(_) | Value::Tuple(_) => Ok(items),
            other => {
                let found = other.kind();
                Err(self.wrong(Global::Set, format!("is made of {found}, allowed: a list")))
            }
        }
    }

    /// Text whose characters are bytes.
    fn encode(&mut self, text: Id, encoding: Id) -> Result<Id, PickleError> {
        let (Value::Text(text), Value::Text(encoding)) = (self.value(text), self.value(encoding))
        else {
            return Err(self.wrong(Global::Encode, "is given no text".to_owned()));
        };
        if &**encoding != "latin1" {
            let found = super::error::shown(encoding);
            let detail = format!("is asked for {found:?}, allowed: \"latin1\"");
            return Err(self.wrong(Global::Encode, detail));
        }
        let total = self.encoded_bytes + text.len();
        if total > self.bytes.len() {
            return Err(self.wrong(Global::Encode, "is given the same text again".to_owned()));
        }
        let bytes: Option<Box<[u8]>> = text.chars().map(|c| u8::try_from(c).ok()).collect();
        match bytes {
            Some(bytes) => {
                self.encoded_bytes = total;
                self.add(Value::Bytes(bytes))
            }
            None => Err(self.wrong(Global::Encode, "is given characters past 255".to_owned())),
        }
    }

    fn reconstruct(&mut self, class: Id) -> Result<Id, PickleError> {
        match self.value(class) {
            Value::Global(Global::NdArray) => self.add(Value::BlankArray),
            other => {
                let found = other.kind();
                let detail = format!("makes {found}, allowed: a numpy.ndarray");
                Err(self.wrong(Global::Reconstruct, detail))
            }
        }
    }

    fn dtype(&mut self, code: Id) -> Result<Id, PickleError> {
        let code = match self.value(code) {
            Value::Text(code) => super::error::shown(code),
            other => other.kind().to_owned(),
        };
        let element = match code.as_str() {
            "O8" | "O" => None,
            code => match Element::from_code(code) {
                Some(element) => Some(element),
                None => {
                    let allowed = "f2, f4, f8, i1 to i8, u1 to u8, b1, O8";
                    let detail = format!("is {code:?}, allowed: {allowed}");
                    return Err(self.wrong(Global::DType, detail));
                }
            },
        };
        let big_endian = false;
        self.add(Value::DType(DType { element, big_endian }))
    }

    fn scalar(&mut self, dtype: Id, bytes: Id) -> Result<Id, PickleError> {
        let value = match (self.value(dtype), self.value(bytes)) {
            (Value::DType(DType { element: Some(element), big_endian }), Value::Bytes(bytes))
                if bytes.len() == element.size() =>
            {
                element.decode(bytes, *big_endian)
            }
            (dtype, bytes) => {
                let detail = format!("is made of {} and {}", dtype.kind(), bytes.kind());
                return Err(self.wrong(Global::Scalar, detail));
            }
        };
        self.add(Value::Float(value))
    }

    /// The state of an array: version, shape, dtype, order, contents.
    fn array_from(&self, state: &[Id]) -> Result<Value, PickleError> {
        let wrong = |detail: &str| Err(self.wrong(Global::Reconstruct, detail.to_owned()));
        let &[_, shape, dtype, order, data] = state else {
            return wrong("has a state that is not (version, shape, dtype, order, contents)");
        };
        let shape = self.sizes(shape)?;
        let (&Value::DType(dtype), &Value::Bool(fortran_order)) =
            (self.value(dtype), self.value(order))
        else {
            return wrong("has no dtype or no order");
        };
        let Some(count) = product(&shape) else {
            return wrong("has an impossible shape");
        };
        match (dtype.element, self.value(data)) {
            (None, Value::List(items)) if items.len() == count => Ok(Value::Objects(data)),
            (Some(element), Value::Bytes(bytes))
                if Some(bytes.len()) == count.checked_mul(element.size()) =>
            {
                Ok(Value::Array(Box::new(Array {
                    shape,
                    fortran_order,
                    element,
                    big_endian: dtype.big_endian,
                    data,
                })))
            }
            (element, data) => {
                let element = element.map_or("objects", Element::name);
                let found = match data {
                    Value::Bytes(bytes) => format!("{} bytes", bytes.len()),
                    Value::List(items) => format!("a list of {}", items.len()),
                    other => other.kind().to_owned(),
                };
                wrong(&format!("has the shape {shape:?} of {element}, but {found} of contents"))
            }
        }
    }

    fn tensor(
        &mut self,
        storage: Id,
        offset: Id,
        shape: Id,
        strides: Id,
    ) -> Result<Id, PickleError> {
        let count = match self.value(storage) {
            Value::Storage(storage) => storage.count,
            other => {
                let detail = format!("views {}, allowed: a storage", other.kind());
                return Err(self.wrong(Global::RebuildTensor, detail));
            }
        };
        let offset = match self.value(offset) {
            Value::Int(offset) => usize::try_from(*offset).ok(),
            _ => None,
        };
        let (shape, strides) = (self.sizes(shape)?, self.sizes(strides)?);
        let Some(offset) = offset.filter(|&offset| fits(offset, &shape, &strides, count)) else {
            let detail = format!(
                "has the shape {shape:?} with strides {strides:?}, which is no part of a storage of \
                 {count} elements"
            );
            return Err(self.wrong(Global::RebuildTensor, detail));
        };
        self.add(Value::Tensor(Box::new(Tensor { storage, offset, shape, strides })))
    }

    /// A shape or strides.
    fn sizes(&self, id: Id) -> Result<Vec<usize>, PickleError> {
        let items = match self.value(id) {
            Value::Tuple(items) if items.len() <= MAX_DIMENSIONS => items.as_slice(),
            other => {
                let detail = format!(
                    "has {} as shape, allowed: at most {MAX_DIMENSIONS} sizes",
                    other.kind()
                );
                return Err(self.refuse("TUPLE", detail));
            }
        };
        let size = |&item: &Id| match self.value(item) {
            Value::Int(size) => usize::try_from(*size).ok(),
            _ => None,
        };
        let sizes: Option<Vec<usize>> = items.iter().map(size).collect();
        sizes.ok_or_else(|| self.refuse("TUPLE", "has a size that is not an integer".to_owned()))
    }

    fn wrong(&self, global: Global, detail: String) -> PickleError {
        let function = match global {
            Global::OrderedDict => "collections.OrderedDict",
            Global::Set => "set",
            Global::Encode => "_codecs.encode",
            Global::Reconstruct => "numpy's array",
            Global::NdArray => "numpy.ndarray",
            Global::DType => "numpy.dtype",
            Global::Scalar => "numpy's scalar",
            Global::RebuildTensor => "torch's tensor",
            Global::RebuildParameter => "torch's parameter",
            Global::Size => "torch.Size",
            Global::Storage(_) => "torch's storage",
            Global::Layer(layer) => layer,
        };
        PickleError::Call { at: self.opcode_at, function, detail }
    }
}

/// Number of elements. `None` on overflow.
pub(crate) fn product(shape: &[usize]) -> Option<usize> {
    shape.iter().try_fold(1_usize, |product, &size| product.checked_mul(size))
}

/// True if a view lies within a storage of `count` elements and has no more elements than that.
fn fits(offset: usize, shape: &[usize], strides: &[usize], count: usize) -> bool {
    let Some(elements) = product(shape) else {
        return false;
    };
    if shape.len() != strides.len() || elements > count {
        return false;
    }
    if elements == 0 {
        return offset <= count;
    }
    let mut dimensions = shape.iter().zip(strides);
    let last = dimensions.try_fold(offset, |last, (&size, &stride)| {
        last.checked_add((size - 1).checked_mul(stride)?)
    });
    last.is_some_and(|last| last < count)
}
