//! A worker's state in a file: its own, or that of the leader on another host.

use std::io;
use std::path::{Path, PathBuf};

use joulebus_bus::clock;
use joulebus_wire::fnv1a;

use super::files::replace;

/// First bytes of the file. The last of them is its version.
const MAGIC: [u8; 8] = *b"jbsaved\x01";
/// Maximum length of a boot id, bytes.
const MAX_BOOT_ID_BYTES: usize = 64;
/// Magic, five numbers, and the boot.
const HEAD_BYTES: usize = 8 + 5 * 8 + MAX_BOOT_ID_BYTES;
/// Largest file: of a million robots it takes a fifth of that.
const MAX_BYTES: u64 = 4 << 30;

/// An encoded state of a fleet (`FleetState` of `joulebus-fleet`), with its origin.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SavedState {
    /// Term of the worker that it was taken from.
    pub term: u64,
    /// When it was taken, monotonic ns of this host.
    pub taken_ns: u64,
    /// Offset to add to its instants to get those of this host, ns.
    pub offset_ns: i64,
    /// The state.
    pub bytes: Vec<u8>,
}

impl SavedState {
    /// Reads the state in a file. `None` if there is none, or it is of another boot, whose instants
    /// are meaningless now.
    ///
    /// # Errors
    /// [`SavedStateError`].
    pub fn read(path: &Path) -> Result<Option<Self>, SavedStateError> {
        let failed = |source| SavedStateError::Io { path: path.to_owned(), source };
        let bytes = match joulebus_files::read(path, MAX_BYTES) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(failed(error)),
        };
        let (boot, state) = parse(bytes)
            .map_err(|reason| SavedStateError::Damaged { path: path.to_owned(), reason })?;
        Ok((boot == boot_bytes().map_err(failed)?).then_some(state))
    }

    /// Replaces the state in the file.
    ///
    /// # Errors
    /// [`SavedStateError::Io`]. The one before is there.
    pub fn write(
        path: &Path,
        (term, taken_ns, offset_ns): (u64, u64, i64),
        bytes: &[u8],
    ) -> Result<(), SavedStateError> {
        let written = boot_bytes().and_then(|boot| {
            let mut head = Vec::with_capacity(HEAD_BYTES);
            head.extend_from_slice(&MAGIC);
            let numbers = [term, taken_ns, offset_ns.cast_unsigned(), bytes.len() as u64];
            for number in numbers {
                head.extend_from_slice(&number.to_le_bytes());
            }
            head.extend_from_slice(&boot);
            let sum = fnv1a(head.iter().chain(bytes).copied());
            head.extend_from_slice(&sum.to_le_bytes());
            replace(path, &[&head, bytes])
        });
        written.map_err(|source| SavedStateError::Io { path: path.to_owned(), source })
    }

    /// Sort key by age: the term, then the time at which it was taken.
    pub const fn order(&self) -> (u64, u64) {
        (self.term, self.taken_ns)
    }
}

/// The boot and the state in a file's bytes, or what is wrong with them.
fn parse(mut bytes: Vec<u8>) -> Result<([u8; MAX_BOOT_ID_BYTES], SavedState), String> {
    let Some((head, payload)) = bytes.split_first_chunk::<HEAD_BYTES>() else {
        return Err(format!("it has {} bytes, at least {HEAD_BYTES} are needed", bytes.len()));
    };
    if !head.starts_with(&MAGIC) {
        return Err(format!("it begins with {:02x?}", &head[..MAGIC.len()]));
    }
    let number = |at: usize| {
        let place = head[at..].first_chunk::<8>();
        place.map_or(0, |bytes| u64::from_le_bytes(*bytes))
    };
    let [term, taken_ns, offset_ns, length] = [8, 16, 24, 32].map(number);
    if payload.len() as u64 != length {
        return Err(format!("it has {} bytes of a state with {length}", payload.len()));
    }
    let sum_at = HEAD_BYTES - 8;
    let (expected, found) = (fnv1a(head[..sum_at].iter().chain(payload).copied()), number(sum_at));
    if found != expected {
        return Err(format!("its checksum is {found:016x}, that of its content {expected:016x}"));
    }
    let mut boot = [0; MAX_BOOT_ID_BYTES];
    boot.copy_from_slice(&head[40..sum_at]);
    bytes.drain(..HEAD_BYTES);
    let state = SavedState { term, taken_ns, offset_ns: offset_ns.cast_signed(), bytes };
    Ok((boot, state))
}

/// The id of this boot, padded with zeros.
fn boot_bytes() -> io::Result<[u8; MAX_BOOT_ID_BYTES]> {
    let id = clock::boot_id()?;
    let mut boot = [0; MAX_BOOT_ID_BYTES];
    let length = id.len().min(MAX_BOOT_ID_BYTES);
    boot[..length].copy_from_slice(&id.as_bytes()[..length]);
    Ok(boot)
}

/// Reason that a state could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum SavedStateError {
    /// The system call failed.
    #[error("state {path:?}: {source}")]
    Io { path: PathBuf, source: io::Error },
    /// The file is damaged, or something else.
    #[error("state {path:?} is damaged: {reason}. Remove it if it stays so")]
    Damaged { path: PathBuf, reason: String },
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn a_state_is_read_as_it_was_written_and_every_changed_byte_is_detected() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("replica-lab");
        assert_eq!(SavedState::read(&path).unwrap(), None);
        let state =
            SavedState { term: 3, taken_ns: 1 << 40, offset_ns: -77, bytes: (0..200).collect() };
        let write = || {
            let of = (state.term, state.taken_ns, state.offset_ns);
            SavedState::write(&path, of, &state.bytes).unwrap();
        };
        write();
        assert_eq!(SavedState::read(&path).unwrap(), Some(state.clone()));
        let whole = fs::read(&path).unwrap();
        for at in 0..whole.len() {
            let mut changed = whole.clone();
            changed[at] ^= 1 << (at % 8);
            fs::write(&path, &changed).unwrap();
            assert!(SavedState::read(&path).is_err(), "byte {at}");
            fs::write(&path, &whole[..at]).unwrap();
            assert!(SavedState::read(&path).is_err(), "{at} bytes");
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
