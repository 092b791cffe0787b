#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod disk;
mod ending;
pub mod foreign;
mod whole;
mod whole_folder;

use std::fs::{File, Metadata, OpenOptions};
use std::io::{self, Read as _};
use std::os::unix::fs::{FileTypeExt as _, OpenOptionsExt as _, PermissionsExt as _};
use std::path::Path;

use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};

pub use ending::{ends_in, without_ending};
pub use whole::{check_kind, create, replace, replace_shared};
pub use whole_folder::WholeFolder;

/// Reason that a file is refused, as the cause of an [`io::Error`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum Refused {
    /// The path is not a regular file.
    #[error("is {found}, allowed are regular files")]
    Kind { found: &'static str },
    /// The path has a file that no program of joulebus has written.
    #[error(
        "begins with {found:?}, which is not what would be written there, and is not overwritten. \
         Move it away, or name another file"
    )]
    Foreign { found: String },
    /// The file is longer than the limit.
    #[error("has {found} bytes, allowed are {allowed}")]
    TooLong { found: u64, allowed: u64 },
    /// Others may read a secret.
    #[error("has mode {mode:04o}: others may read it. `chmod 600` makes it its owner's alone")]
    Readable { mode: u32 },
}

impl From<Refused> for io::Error {
    fn from(refused: Refused) -> Self {
        let kind = match refused {
            Refused::Kind { .. } => io::ErrorKind::InvalidInput,
            Refused::Foreign { .. } => io::ErrorKind::AlreadyExists,
            Refused::TooLong { .. } => io::ErrorKind::FileTooLarge,
            Refused::Readable { .. } => io::ErrorKind::PermissionDenied,
        };
        Self::new(kind, refused)
    }
}

/// Metadata of a regular file.
///
/// # Errors
/// The error of the system, or [`Refused::Kind`].
pub fn look(path: &Path) -> io::Result<Metadata> {
    regular(std::fs::metadata(path)?)
}

/// Opens a regular file for reading. Does not block on a pipe.
///
/// # Errors
/// The error of the system, or [`Refused::Kind`].
pub fn open(path: &Path) -> io::Result<File> {
    // Before opening, because of devices, and again after, because the path may refer to another
    // file by then.
    look(path)?;
    let flags = OFlags::NONBLOCK | OFlags::NOCTTY;
    let file = OpenOptions::new().read(true).custom_flags(flags.bits().cast_signed()).open(path)?;
    regular(file.metadata()?)?;
    fcntl_setfl(&file, fcntl_getfl(&file)? - OFlags::NONBLOCK)?;
    Ok(file)
}

/// All bytes of a regular file of at most `max_bytes`.
///
/// # Errors
/// As of [`open`]. [`Refused::TooLong`].
pub fn read(path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
    read_opened(open(path)?, max_bytes)
}

fn read_opened(file: File, max_bytes: u64) -> io::Result<Vec<u8>> {
    let allowed = |found: u64| match found > max_bytes {
        true => Err(Refused::TooLong { found, allowed: max_bytes }),
        false => Ok(()),
    };
    allowed(file.metadata()?.len())?;
    let mut bytes = Vec::new();
    // The file may grow, or the system may not know its length.
    file.take(max_bytes.saturating_add(1)).read_to_end(&mut bytes)?;
    allowed(bytes.len() as u64)?;
    Ok(bytes)
}

/// The text of a regular file of at most `max_bytes`.
///
/// # Errors
/// As of [`read`]. The text is not UTF-8.
pub fn read_to_string(path: &Path, max_bytes: u64) -> io::Result<String> {
    text(read(path, max_bytes)?)
}

fn text(bytes: Vec<u8>) -> io::Result<String> {
    String::from_utf8(bytes)
        .map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error.utf8_error()))
}

/// Same as [`read_to_string`], for a file that only its owner can read.
///
/// # Errors
/// Those of [`read_to_string`], and [`Refused::Readable`].
pub fn read_secret(path: &Path, max_bytes: u64) -> io::Result<String> {
    let file = open(path)?;
    // Of what is read: the path may refer to another file by now.
    let mode = file.metadata()?.permissions().mode() & 0o777;
    if mode & 0o077 != 0 {
        return Err(Refused::Readable { mode }.into());
    }
    text(read_opened(file, max_bytes)?)
}

/// The first line of a file that only its owner can read, such as a password.
///
/// # Errors
/// Those of [`read_secret`]. The line is empty, or the file is longer than 4 kB.
pub fn read_secret_line(path: &Path) -> io::Result<String> {
    let text = read_secret(path, 4_096)?;
    let line = text.lines().next().filter(|line| !line.is_empty());
    let empty = || io::Error::new(io::ErrorKind::InvalidData, "has an empty first line");
    line.map(str::to_owned).ok_or_else(empty)
}

fn regular(about: Metadata) -> io::Result<Metadata> {
    let kind = about.file_type();
    let found = match () {
        () if kind.is_file() => return Ok(about),
        () if kind.is_dir() => "a directory",
        () if kind.is_fifo() => "a named pipe",
        () if kind.is_socket() => "a socket",
        () if kind.is_char_device() || kind.is_block_device() => "a device",
        () => "no regular file",
    };
    Err(Refused::Kind { found }.into())
}
