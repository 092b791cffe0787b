//! PyTorch's files: a zip archive with a pickle and one member for each storage, or, before
//! version 1.6, five pickles and the storages one after another.

use std::collections::HashMap;

use super::archive::Member;
use super::entries::of_pickle;
use super::pickle::{Pickle, Storage, Storages, Value};
use super::{Container, Entry, PickleError, ReadError};

/// The pickle in a zip archive.
const PROGRAM: &str = "/data.pkl";
/// Magic of a legacy file: an integer as a pickle, up to its last byte.
const LEGACY_MAGIC: &[u8] = b"\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19.";
const LEGACY_VERSION: i64 = 1001;

/// True if an archive is a PyTorch file.
pub(super) fn is_torch(members: &[Member]) -> bool {
    members.iter().any(|member| member.name.ends_with(PROGRAM))
}

/// True if a file is a PyTorch file of the legacy kind.
pub(super) fn is_legacy(bytes: &[u8]) -> bool {
    bytes.starts_with(LEGACY_MAGIC)
}

/// Entries of a zip archive of PyTorch.
pub(super) fn read_zip(members: &[Member]) -> Result<Vec<Entry>, ReadError> {
    let container = Container::TorchZip;
    let bad = |part: &str, detail: &str| ReadError::Part {
        container,
        part: format!("member {part:?}"),
        detail: detail.to_owned(),
    };
    let mut programs = members.iter().filter(|member| member.name.ends_with(PROGRAM));
    let (Some(program), None) = (programs.next(), programs.next()) else {
        return Err(bad("data.pkl", "found several, allowed: one"));
    };
    let prefix = program.name.strip_suffix("data.pkl").unwrap_or_default();
    let member = |name: &str| {
        let mut members = members.iter();
        members.find(|member| member.name.strip_prefix(prefix) == Some(name))
    };
    if member("constants.pkl").is_some() {
        let detail = "this is a TorchScript archive, which holds a program. Save the state dict";
        return Err(bad("constants.pkl", detail));
    }
    if member("byteorder").is_some_and(|order| order.bytes != b"little") {
        return Err(bad("byteorder", "found another order, allowed: little"));
    }
    let pickle = Pickle::read(&program.bytes, 0, Storages::Outside);
    let pickle = pickle.map_err(in_part(container, "data.pkl"))?;
    let fetch = |storage: &Storage| {
        let name = format!("data/{}", storage.key);
        match member(&name) {
            Some(member) => sized(storage, &member.bytes),
            None => Err(format!("its numbers should be in member {name:?}, which is missing")),
        }
    };
    of_pickle(container, &pickle, &fetch)
}

/// Entries of a legacy PyTorch file.
pub(super) fn read_legacy(bytes: &[u8]) -> Result<Vec<Entry>, ReadError> {
    let container = Container::TorchLegacy;
    let mut at = LEGACY_MAGIC.len();
    let mut next = |part: &'static str| {
        let pickle = Pickle::read(bytes, at, Storages::Outside);
        let pickle = pickle.map_err(in_part(container, part))?;
        at = pickle.end;
        Ok::<Pickle, ReadError>(pickle)
    };
    let version = next("version")?;
    let system = next("system")?;
    let object = next("object")?;
    let keys = next("list of storages")?;
    check_origin(&version, &system)?;
    let storages = storages(bytes, at, &object, &keys)?;
    let fetch = |storage: &Storage| match storages.get(&*storage.key) {
        Some(bytes) => sized(storage, bytes),
        None => Err(format!("its storage {:?} is missing", storage.key)),
    };
    of_pickle(container, &object, &fetch)
}

/// Refuses files of another version or byte order.
fn check_origin(version: &Pickle, system: &Pickle) -> Result<(), ReadError> {
    let bad = |part: &str, detail: String| {
        Err(ReadError::Part {
            container: Container::TorchLegacy,
            part: format!("{part}, before byte {}", system.end),
            detail,
        })
    };
    match version.value(version.root()) {
        Value::Int(LEGACY_VERSION) => {}
        other => {
            return bad("version", format!("found {other:?}, allowed: {LEGACY_VERSION}"));
        }
    }
    let little = match system.value(system.root()) {
        Value::Dict(pairs) => {
            pairs.iter().find_map(|&(key, value)| match (system.value(key), system.value(value)) {
                (Value::Text(key), &Value::Bool(value)) if &**key == "little_endian" => Some(value),
                _ => None,
            })
        }
        _ => None,
    };
    match little {
        Some(true) => Ok(()),
        _ => bad("system", "little_endian is not true, allowed: true".to_owned()),
    }
}

/// The elements of each storage: a count and as many elements, in the order of the keys.
fn storages<'a>(
    bytes: &'a [u8],
    mut at: usize,
    object: &Pickle,
    keys: &Pickle,
) -> Result<HashMap<String, &'a [u8]>, ReadError> {
    let bad = |at: usize, detail: String| {
        Err(ReadError::Part {
            container: Container::TorchLegacy,
            part: format!("storages, byte {at}"),
            detail,
        })
    };
    let Value::List(list) = keys.value(keys.root()) else {
        return bad(at, "found no list of storages before the storages".to_owned());
    };
    let used: HashMap<&str, &Storage> =
        object.storages().map(|storage| (&*storage.key, storage)).collect();
    let mut storages = HashMap::new();
    for &key in list {
        let Value::Text(key) = keys.value(key) else {
            return bad(at, "a storage has a key that is not text".to_owned());
        };
        let Some(storage) = used.get(&**key) else {
            return bad(at, format!("nothing uses the storage {key:?}"));
        };
        let needed = storage.count.saturating_mul(storage.element.size());
        let count = bytes.get(at..at + 8);
        let count =
            count.map(|count| count.iter().rev().fold(0_u64, |n, b| n << 8 | u64::from(*b)));
        if count != Some(storage.count as u64) {
            let found = count.map_or("the end".to_owned(), |count| format!("{count} elements"));
            let detail =
                format!("storage {key:?}: found {found}, allowed: {} elements", storage.count);
            return bad(at, detail);
        }
        let left = &bytes[at + 8..];
        let Some(numbers) = left.get(..needed) else {
            let left = left.len();
            return bad(at, format!("storage {key:?} needs {needed} bytes, {left} are left"));
        };
        at += 8 + needed;
        if storages.insert(key.to_string(), numbers).is_some() {
            return bad(at, format!("the storage {key:?} occurs twice"));
        }
    }
    if at != bytes.len() {
        return bad(at, format!("{} bytes follow the last storage", bytes.len() - at));
    }
    Ok(storages)
}

fn sized<'a>(storage: &Storage, bytes: &'a [u8]) -> Result<&'a [u8], String> {
    let needed = storage.count.checked_mul(storage.element.size());
    if needed == Some(bytes.len()) {
        return Ok(bytes);
    }
    let (found, count, element) = (bytes.len(), storage.count, storage.element.name());
    Err(format!("storage {:?} has {found} bytes, should hold {count} of {element}", storage.key))
}

fn in_part(container: Container, part: &'static str) -> impl Fn(PickleError) -> ReadError {
    move |source| ReadError::Pickle { container, part: part.to_owned(), source }
}
