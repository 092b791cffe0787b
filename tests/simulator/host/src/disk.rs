//! The disk: files and names, what of them would survive a power failure, and faults.
//!
//! Bytes are durable when their file was synced, names when their directory was. What is not
//! durable when the power fails survives in part, in any order.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};

use crate::current::current;
use crate::memory::outside;
use crate::processes::{below, disk_access, has_descriptors, is_dead, once_in, operation};

/// A fault of the disk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    None,
    /// Every third access fails.
    Failing,
    /// There is space for a few bytes more, and then none.
    Full,
    /// Only a part of what is to be written is.
    Short,
}

#[derive(Debug, Default)]
struct Content {
    bytes: Vec<u8>,
    durable: Vec<u8>,
    is_synced: bool,
}

/// A change of names that is not durable yet.
#[derive(Debug, Clone)]
enum Change {
    Created(PathBuf, u64),
    Renamed(PathBuf, PathBuf, u64),
    Removed(PathBuf),
}

#[derive(Debug)]
struct Disk {
    contents: BTreeMap<u64, Content>,
    names: BTreeMap<PathBuf, u64>,
    durable_names: BTreeMap<PathBuf, u64>,
    changes: Vec<Change>,
    fault: Fault,
    /// Space left while the disk is full, bytes.
    room: usize,
    next: u64,
}

thread_local! {
    static DISK: RefCell<Disk> = const {
        RefCell::new(Disk {
            contents: BTreeMap::new(),
            names: BTreeMap::new(),
            durable_names: BTreeMap::new(),
            changes: Vec::new(),
            fault: Fault::None,
            room: 0,
            next: 0,
        })
    };
}

fn with<T>(work: impl FnOnce(&mut Disk) -> T) -> T {
    outside(|| DISK.with_borrow_mut(work))
}

pub(crate) fn begin() {
    with(|disk| {
        disk.contents.clear();
        disk.names.clear();
        disk.durable_names.clear();
        disk.changes.clear();
        disk.fault = Fault::None;
        disk.next = 0;
    });
}

/// Maximum space that a disk has left when it begins to be full, bytes.
const MAX_ROOM: usize = 20_000;

pub fn fail(fault: Fault) {
    let room = if fault == Fault::Full { below(MAX_ROOM) } else { 0 };
    with(|disk| (disk.fault, disk.room) = (fault, room));
}

fn not_found() -> io::Error {
    io::Error::from(ErrorKind::NotFound)
}

/// An access by a process, which may fail.
fn access(opens: bool) -> io::Result<Fault> {
    disk_access();
    if is_dead() {
        return Err(io::Error::other("the process is dead"));
    }
    if opens && !has_descriptors(current()) {
        return Err(io::Error::other("too many open files"));
    }
    let fault = with(|disk| disk.fault);
    if fault == Fault::Failing && once_in(3) {
        return Err(io::Error::other("input/output error"));
    }
    Ok(fault)
}

impl Disk {
    fn create(&mut self, path: &Path) -> u64 {
        self.next += 1;
        self.contents.insert(self.next, Content::default());
        self.names.insert(path.to_owned(), self.next);
        self.changes.push(Change::Created(path.to_owned(), self.next));
        self.next
    }

    /// Forgets contents without a name.
    fn collect(&mut self) {
        if self.contents.len() > 4 * self.names.len() + 16 {
            let (names, durable, changes) = (&self.names, &self.durable_names, &self.changes);
            let changed = |number: u64| {
                changes.iter().any(|change| match change {
                    Change::Created(_, of) | Change::Renamed(_, _, of) => *of == number,
                    Change::Removed(_) => false,
                })
            };
            self.contents.retain(|number, _| {
                names.values().chain(durable.values()).any(|of| of == number) || changed(*number)
            });
        }
    }
}

#[derive(Debug)]
pub struct File {
    number: u64,
}

impl File {
    /// Opens the file.
    ///
    /// # Errors
    /// There is none, or the disk fails.
    pub fn open(path: impl AsRef<Path>) -> io::Result<Self> {
        access(true)?;
        let number = with(|disk| disk.names.get(path.as_ref()).copied());
        number.map(|number| Self { number }).ok_or_else(not_found)
    }

    /// Creates the file, or makes it empty.
    ///
    /// # Errors
    /// The disk fails or is full.
    pub fn create(path: impl AsRef<Path>) -> io::Result<Self> {
        if access(true)? == Fault::Full {
            return Err(ErrorKind::StorageFull.into());
        }
        with(|disk| {
            if let Some(number) = disk.names.get(path.as_ref()).copied() {
                let content = disk.contents.entry(number).or_default();
                (content.bytes, content.is_synced) = (Vec::new(), false);
                return Ok(Self { number });
            }
            Ok(Self { number: disk.create(path.as_ref()) })
        })
    }

    /// Creates the file.
    ///
    /// # Errors
    /// There is one; the disk fails or is full.
    pub fn create_new(path: impl AsRef<Path>) -> io::Result<Self> {
        if exists(path.as_ref()) {
            return Err(ErrorKind::AlreadyExists.into());
        }
        Self::create(path)
    }

    /// Sets the length.
    ///
    /// # Errors
    /// The disk fails.
    pub fn set_len(&self, len: u64) -> io::Result<()> {
        access(false)?;
        with(|disk| {
            let content = disk.contents.get_mut(&self.number).ok_or_else(not_found)?;
            content.bytes.resize(len as usize, 0);
            content.is_synced = false;
            Ok(())
        })
    }

    /// Makes all bytes durable.
    ///
    /// # Errors
    /// The disk fails.
    pub fn sync_all(&self) -> io::Result<()> {
        access(false)?;
        with(|disk| {
            let content = disk.contents.get_mut(&self.number).ok_or_else(not_found)?;
            content.durable.clone_from(&content.bytes);
            content.is_synced = true;
            Ok(())
        })
    }
}

impl Drop for File {
    /// Closing a file is a call that reaches the host.
    fn drop(&mut self) {
        if !std::thread::panicking() {
            operation();
        }
    }
}

impl Write for File {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let fault = access(false)?;
        let room = with(|disk| disk.room);
        if fault == Fault::Full && room == 0 {
            return Err(ErrorKind::StorageFull.into());
        }
        let count = match fault {
            Fault::Short if bytes.len() > 1 => 1 + below(bytes.len() - 1),
            // The write that meets the end of the space is a short one.
            Fault::Full => bytes.len().min(room),
            _ => bytes.len(),
        };
        with(|disk| {
            disk.room = disk.room.saturating_sub(count);
            let content = disk.contents.get_mut(&self.number).ok_or_else(not_found)?;
            content.bytes.extend_from_slice(&bytes[..count]);
            content.is_synced = false;
            Ok(count)
        })
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Renames a file, replacing another.
///
/// # Errors
/// There is no such file, or the disk fails.
pub fn rename(from: impl AsRef<Path>, to: impl AsRef<Path>) -> io::Result<()> {
    access(false)?;
    let (from, to) = (from.as_ref().to_owned(), to.as_ref().to_owned());
    with(|disk| {
        let number = disk.names.remove(&from).ok_or_else(not_found)?;
        disk.names.insert(to.clone(), number);
        disk.changes.push(Change::Renamed(from, to, number));
        disk.collect();
        Ok(())
    })
}

/// Removes a file.
///
/// # Errors
/// There is no such file, or the disk fails.
pub fn remove_file(path: impl AsRef<Path>) -> io::Result<()> {
    access(false)?;
    with(|disk| {
        disk.names.remove(path.as_ref()).ok_or_else(not_found)?;
        disk.changes.push(Change::Removed(path.as_ref().to_owned()));
        Ok(())
    })
}

/// Directories need not be created.
///
/// # Errors
/// The disk fails.
pub fn create_dir_all(_path: impl AsRef<Path>) -> io::Result<()> {
    access(false)?;
    Ok(())
}

/// True if there is something of that name.
pub fn exists(path: &Path) -> bool {
    operation();
    with(|disk| disk.names.contains_key(path))
}

/// True if there is a file of that name: there are no links.
pub fn is_file(path: &Path) -> bool {
    exists(path)
}

/// Identity of a file, whatever its name.
pub type FileId = u64;

/// As [`File::create_new`].
///
/// # Errors
/// There is one; the disk fails or is full.
pub fn create_new(path: &Path) -> io::Result<File> {
    File::create_new(path)
}

/// As [`File::create`].
///
/// # Errors
/// The disk fails or is full.
pub fn create(path: &Path) -> io::Result<File> {
    File::create(path)
}

/// Creates a file; all files are written at their end.
///
/// # Errors
/// There is one; the disk fails or is full.
pub fn create_to_append(path: &Path) -> io::Result<File> {
    File::create_new(path)
}

/// The id of an open file.
///
/// # Errors
/// None.
pub fn id(file: &File) -> io::Result<FileId> {
    Ok(file.number)
}

/// The file of that name and its length. `None` if there is none.
///
/// # Errors
/// The disk fails.
pub fn found_at(path: &Path) -> io::Result<Option<(FileId, u64)>> {
    access(false)?;
    with(|disk| {
        let number = disk.names.get(path).copied();
        Ok(number.map(|number| (number, disk.contents[&number].bytes.len() as u64)))
    })
}

/// Version of a file, to distinguish it from one that has replaced it.
pub type Version = u64;

/// The version of the file of that name.
///
/// # Errors
/// There is none, or the disk fails.
pub fn version(path: &Path) -> io::Result<Version> {
    access(false)?;
    with(|disk| disk.names.get(path).copied()).ok_or_else(not_found)
}

/// Makes the names in a directory durable.
///
/// # Errors
/// The disk fails.
pub fn sync_directory(path: &Path) -> io::Result<()> {
    access(true)?;
    with(|disk| {
        let (names, durable) = (&disk.names, &mut disk.durable_names);
        durable.retain(|name, _| name.parent() != Some(path));
        let inside = names.iter().filter(|(name, _)| name.parent() == Some(path));
        durable.extend(inside.map(|(name, number)| (name.clone(), *number)));
        disk.changes.retain(|change| match change {
            Change::Created(name, _) | Change::Renamed(_, name, _) | Change::Removed(name) => {
                name.parent() != Some(path)
            }
        });
    });
    Ok(())
}

/// All bytes of a file.
///
/// # Errors
/// There is no such file, or the disk fails.
pub fn read(path: &Path) -> io::Result<Vec<u8>> {
    access(true)?;
    peek(path).ok_or_else(not_found)
}

/// All bytes of a file, for the simulator.
pub fn peek(path: &Path) -> Option<Vec<u8>> {
    with(|disk| {
        let number = disk.names.get(path)?;
        Some(disk.contents.get(number)?.bytes.clone())
    })
}

/// The bytes of a file that would survive a power failure whatever else does, for the simulator.
pub fn peek_durable(path: &Path) -> Option<Vec<u8>> {
    with(|disk| {
        let number = disk.durable_names.get(path)?;
        Some(disk.contents.get(number)?.durable.clone())
    })
}

/// Puts a durable file, or changes it, for the simulator.
pub fn put(path: &Path, bytes: Vec<u8>) {
    with(|disk| {
        let number = match disk.names.get(path) {
            Some(number) => *number,
            None => disk.create(path),
        };
        disk.durable_names.insert(path.to_owned(), number);
        let content = disk.contents.entry(number).or_default();
        content.durable.clone_from(&bytes);
        (content.bytes, content.is_synced) = (bytes, true);
    });
}

/// Removes a file, for the simulator.
pub fn take_away(path: &Path) {
    with(|disk| {
        disk.names.remove(path);
        disk.durable_names.remove(path);
        disk.changes.retain(|change| match change {
            Change::Created(name, _) | Change::Renamed(_, name, _) | Change::Removed(name) => {
                name != path
            }
        });
    });
}

/// True if a file would survive a power failure with all its bytes.
pub fn is_durable(path: &Path) -> bool {
    with(|disk| {
        let number = disk.durable_names.get(path);
        let content = number.and_then(|number| disk.contents.get(number));
        number == disk.names.get(path) && content.is_some_and(|content| content.is_synced)
    })
}

/// Names of all files.
pub fn names() -> Vec<PathBuf> {
    with(|disk| disk.names.keys().cloned().collect())
}

/// The power fails: of what is not durable, parts survive.
pub fn lose_power() {
    with(|disk| {
        let mut names = disk.durable_names.clone();
        for change in std::mem::take(&mut disk.changes) {
            if once_in(2) {
                continue;
            }
            match change {
                Change::Created(name, number) => {
                    names.entry(name).or_insert(number);
                }
                Change::Renamed(from, to, number) => {
                    names.remove(&from);
                    names.insert(to, number);
                }
                Change::Removed(name) => {
                    names.remove(&name);
                }
            }
        }
        for content in disk.contents.values_mut().filter(|content| !content.is_synced) {
            let written = std::mem::take(&mut content.bytes);
            content.bytes = torn(&content.durable, written);
            content.durable.clone_from(&content.bytes);
            content.is_synced = true;
        }
        disk.durable_names.clone_from(&names);
        disk.names = names;
        disk.collect();
    });
}

/// Sectors of what was written and of what is durable, in any mixture.
fn torn(durable: &[u8], mut written: Vec<u8>) -> Vec<u8> {
    const SECTOR: usize = 512;
    match below(4) {
        0 => return durable.to_vec(),
        1 => return written,
        _ => {}
    }
    written.truncate(below(written.len() + 1));
    for (place, sector) in written.chunks_mut(SECTOR).enumerate() {
        if once_in(2) {
            let from = place * SECTOR;
            for (offset, byte) in sector.iter_mut().enumerate() {
                *byte = durable.get(from + offset).copied().unwrap_or(0);
            }
        }
    }
    written
}
