//! Flattens the tree in a file to a list of paths.

use super::npy::ElementType;
use super::pickle::{Foreign, Id, Pickle, Storage, Storages, Value};
use super::{Container, Entry, EntryValue, ReadError, Tensor, npy};

/// Maximum nesting depth.
const MAX_DEPTH: usize = 16;
/// Maximum number of values visited. A value may be referenced repeatedly.
const MAX_VISITS: usize = 1 << 16;
/// Maximum number of entries.
pub(super) const MAX_ENTRIES: usize = 4_096;
/// Maximum length of a key, bytes.
const MAX_KEY_BYTES: usize = 200;
/// Maximum number of elements of all arrays. Views may share elements.
const MAX_ELEMENTS: usize = 1 << 20;

/// The bytes of a storage.
pub(super) type Fetch<'a> = &'a dyn Fn(&Storage) -> Result<&'a [u8], String>;

/// Entries of a NumPy file.
pub(super) fn of_npy(bytes: &[u8]) -> Result<Vec<Entry>, ReadError> {
    let (header, kind) = npy::header("", bytes)?;
    if kind != ElementType::Objects {
        let (path, value) = (String::new(), npy::value("", bytes)?);
        return Ok(vec![Entry { path, value }]);
    }
    let pickle = Pickle::read(bytes, header.length(), Storages::Inside).map_err(|source| {
        ReadError::Pickle { container: Container::Npy, part: "object array".to_owned(), source }
    })?;
    if pickle.end != bytes.len() {
        return Err(ReadError::Part {
            container: Container::Npy,
            part: format!("object array, byte {}", pickle.end),
            detail: format!("{} bytes follow its end", bytes.len() - pickle.end),
        });
    }
    of_pickle(Container::Npy, &pickle, &no_storage)
}

/// Entries of a bare pickle.
pub(super) fn of_bare_pickle(bytes: &[u8]) -> Result<Vec<Entry>, ReadError> {
    let container = Container::Pickle;
    let pickle = Pickle::read(bytes, 0, Storages::Inside);
    let pickle =
        pickle.map_err(|source| ReadError::Pickle { container, part: "top".to_owned(), source })?;
    of_pickle(container, &pickle, &no_storage)
}

fn no_storage<'a>(_: &Storage) -> Result<&'a [u8], String> {
    Err("there are no storages in this file".to_owned())
}

/// Entries of a set of named arrays.
pub(super) fn of_arrays<'a>(
    container: Container,
    arrays: impl Iterator<Item = (&'a str, &'a [u8])>,
) -> Result<Vec<Entry>, ReadError> {
    let mut entries = Vec::new();
    for (name, bytes) in arrays {
        let path = name.strip_suffix(".npy").unwrap_or(name);
        let value = npy::value(&format!("array {path:?}, "), bytes)?;
        if entries.len() == MAX_ENTRIES {
            return Err(too_many(container, path));
        }
        entries.push(Entry { path: path.to_owned(), value });
    }
    Ok(entries)
}

/// Entries of a pickle.
pub(super) fn of_pickle<'a>(
    container: Container,
    pickle: &'a Pickle,
    fetch: Fetch<'a>,
) -> Result<Vec<Entry>, ReadError> {
    let mut walk = Walk { container, pickle, fetch, entries: Vec::new(), visits: 0, elements: 0 };
    walk.visit(pickle.root(), "", 0)?;
    Ok(walk.entries)
}

struct Walk<'a> {
    container: Container,
    pickle: &'a Pickle,
    fetch: Fetch<'a>,
    entries: Vec<Entry>,
    visits: usize,
    elements: usize,
}

impl Walk<'_> {
    fn visit(&mut self, id: Id, path: &str, depth: usize) -> Result<(), ReadError> {
        self.visits += 1;
        if depth > MAX_DEPTH {
            return Err(self.bad(path, format!("nested deeper than {MAX_DEPTH}")));
        }
        if self.visits > MAX_VISITS {
            return Err(too_many(self.container, path));
        }
        let pickle = self.pickle;
        let value = match pickle.value(id) {
            Value::Dict(pairs) => {
                for &(key, value) in pairs {
                    let path = self.join(path, key)?;
                    self.visit(value, &path, depth + 1)?;
                }
                return Ok(());
            }
            Value::List(items) | Value::Tuple(items) => match self.numbers(items) {
                Some(tensor) => EntryValue::Tensor(tensor),
                None => return self.visit_all(items, path, depth),
            },
            Value::Objects(list) => {
                return match pickle.value(*list) {
                    // An array of one object without dimensions: the usual way to save a dict.
                    Value::List(items) if items.len() == 1 => self.visit(items[0], path, depth + 1),
                    Value::List(items) => self.visit_all(items, path, depth),
                    _ => Ok(()),
                };
            }
            Value::Layer { class, attributes } => {
                self.add(&format!("{path}({class})"), EntryValue::Other("a layer"))?;
                return match attributes {
                    Some(attributes) => self.layer(*attributes, path, depth),
                    None => Ok(()),
                };
            }
            Value::Array(array) => {
                let bytes = match pickle.value(array.data) {
                    Value::Bytes(bytes) => bytes,
                    _ => return Ok(()),
                };
                EntryValue::Tensor(Tensor::dense(
                    array.shape.clone(),
                    array.element,
                    bytes,
                    array.big_endian,
                    array.fortran_order,
                ))
            }
            Value::Tensor(tensor) => {
                let Value::Storage(storage) = pickle.value(tensor.storage) else {
                    return Ok(());
                };
                let bytes = (self.fetch)(storage).map_err(|detail| self.bad(path, detail))?;
                let shape = tensor.shape.clone();
                let (strides, element) = (&tensor.strides, storage.element);
                EntryValue::Tensor(Tensor::view(
                    shape,
                    strides,
                    tensor.offset,
                    element,
                    bytes,
                    false,
                ))
            }
            Value::Text(text) => EntryValue::Text(text.chars().take(MAX_KEY_BYTES).collect()),
            Value::None => return Ok(()),
            Value::Foreign(foreign) => {
                self.check_foreign(foreign, path, depth)?;
                EntryValue::Other(pickle.value(id).kind())
            }
            other => match number(other) {
                Some(number) => EntryValue::Number(number),
                None => EntryValue::Other(other.kind()),
            },
        };
        self.add(path, value)
    }

    /// Refuses an object that is not read but has arrays or layers in it.
    fn check_foreign(
        &mut self,
        foreign: &Foreign,
        path: &str,
        depth: usize,
    ) -> Result<(), ReadError> {
        let mut open: Vec<(Id, usize)> = foreign.parts.iter().map(|&part| (part, depth)).collect();
        while let Some((id, depth)) = open.pop() {
            let parts: Vec<Id> = match self.pickle.value(id) {
                Value::List(items) | Value::Tuple(items) => items.clone(),
                Value::Dict(pairs) => pairs.iter().flat_map(|&(key, value)| [key, value]).collect(),
                Value::Foreign(inner) => inner.parts.clone(),
                Value::Objects(list) => vec![*list],
                Value::Array(_) | Value::Tensor(_) | Value::Storage(_) | Value::Layer { .. } => {
                    return Err(ReadError::Pickle {
                        container: self.container,
                        part: place(path),
                        source: foreign.refused(),
                    });
                }
                _ => Vec::new(),
            };
            self.visits += 1 + parts.len();
            if self.visits > MAX_VISITS {
                return Err(too_many(self.container, path));
            }
            if depth > MAX_DEPTH && !parts.is_empty() {
                return Err(self.bad(path, format!("nested deeper than {MAX_DEPTH}")));
            }
            open.extend(parts.into_iter().map(|part| (part, depth + 1)));
        }
        Ok(())
    }

    fn visit_all(&mut self, items: &[Id], path: &str, depth: usize) -> Result<(), ReadError> {
        for (index, &item) in items.iter().enumerate() {
            self.visit(item, &joined(path, &index.to_string()), depth + 1)?;
        }
        Ok(())
    }

    /// The attributes of a layer: its parameters and children under the names of a state dict, and
    /// its settings. Internal attributes are skipped.
    fn layer(&mut self, attributes: Id, path: &str, depth: usize) -> Result<(), ReadError> {
        let pickle = self.pickle;
        let Value::Dict(pairs) = pickle.value(attributes) else {
            return Ok(());
        };
        for &(key, value) in pairs {
            match pickle.value(key) {
                Value::Text(key) if matches!(&**key, "_parameters" | "_modules" | "_buffers") => {
                    self.visit(value, path, depth + 1)?;
                }
                Value::Text(key) if key.starts_with('_') => {}
                _ => {
                    let path = self.join(path, key)?;
                    self.visit(value, &path, depth + 1)?;
                }
            }
        }
        Ok(())
    }

    /// Lists of numbers, or lists of equally long lists of numbers, as an array.
    fn numbers(&self, items: &[Id]) -> Option<Tensor> {
        let row = |items: &[Id]| -> Option<Vec<f64>> {
            let numbers = items.iter().map(|&item| number(self.pickle.value(item)));
            numbers.collect()
        };
        if items.is_empty() || items.len() > MAX_ENTRIES {
            return None;
        }
        if let Some(values) = row(items) {
            return Some(Tensor::from_numbers(vec![items.len()], values));
        }
        let mut values = Vec::new();
        let mut width = None;
        for &item in items {
            let (Value::List(items) | Value::Tuple(items)) = self.pickle.value(item) else {
                return None;
            };
            let is_even = *width.get_or_insert(items.len()) == items.len();
            if !is_even || values.len() + items.len() > MAX_VISITS {
                return None;
            }
            values.extend(row(items)?);
        }
        let width = width.filter(|&width| width > 0)?;
        Some(Tensor::from_numbers(vec![items.len(), width], values))
    }

    fn join(&self, path: &str, key: Id) -> Result<String, ReadError> {
        match self.pickle.value(key) {
            Value::Text(key) if key.len() <= MAX_KEY_BYTES => Ok(joined(path, key)),
            Value::Int(key) => Ok(joined(path, &key.to_string())),
            Value::Text(_) => {
                Err(self.bad(path, format!("a key of more than {MAX_KEY_BYTES} bytes")))
            }
            other => {
                let found = other.kind();
                Err(self.bad(path, format!("a key that is {found}, allowed: text and integers")))
            }
        }
    }

    fn add(&mut self, path: &str, value: EntryValue) -> Result<(), ReadError> {
        if let EntryValue::Tensor(tensor) = &value {
            self.elements += tensor.values().len();
        }
        if self.entries.len() == MAX_ENTRIES || self.elements > MAX_ELEMENTS {
            return Err(too_many(self.container, path));
        }
        self.entries.push(Entry { path: path.to_owned(), value });
        Ok(())
    }

    fn bad(&self, path: &str, detail: String) -> ReadError {
        ReadError::Part { container: self.container, part: place(path), detail }
    }
}

fn joined(path: &str, key: &str) -> String {
    if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") }
}

fn place(path: &str) -> String {
    if path.is_empty() { "top".to_owned() } else { format!("{path:?}") }
}

fn too_many(container: Container, path: &str) -> ReadError {
    ReadError::Part {
        container,
        part: place(path),
        detail: "more entries than any model has. Check that it is a model file".to_owned(),
    }
}

fn number(value: &Value) -> Option<f64> {
    match *value {
        Value::Bool(value) => Some(f64::from(u8::from(value))),
        Value::Int(value) => Some(value as f64),
        Value::Float(value) => Some(value),
        _ => None,
    }
}
