//! Files that a program writes.

use std::io::{self, Write as _};
use std::path::Path;

use anyhow::Context as _;

/// Writes a file atomically. Pipes and devices are not replaced.
///
/// # Errors
/// The operating system's error, or [`joulebus_files::Refused::Kind`].
pub fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let failed = || format!("cannot write {}", path.display());
    match joulebus_files::look(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            return Err(error).with_context(failed);
        }
        _ => {}
    }
    let folder = path
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    let mut draft = tempfile::Builder::new()
        .permissions(std::os::unix::fs::PermissionsExt::from_mode(0o644))
        .tempfile_in(folder.unwrap_or(Path::new(".")))
        .with_context(failed)?;
    draft.write_all(bytes).with_context(failed)?;
    draft.persist(path).with_context(failed)?;
    Ok(())
}
