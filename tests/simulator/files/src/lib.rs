//! `joulebus-files` on the simulated disk: the same names, for the same sources.
#![forbid(unsafe_code)]

use std::io;
use std::path::Path;

pub use joulebus_files::{Refused, foreign, look, open, read_secret, read_to_string};
pub use joulebus_simulated_host::disk;

/// All bytes of a file of at most `max_bytes`.
///
/// # Errors
/// There is none, it is too long, or the disk fails.
pub fn read(path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
    let bytes = disk::read(path)?;
    let found = bytes.len() as u64;
    if found > max_bytes {
        let allowed = max_bytes;
        return Err(Refused::TooLong { found, allowed }.into());
    }
    Ok(bytes)
}
