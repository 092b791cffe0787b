//! Files that a program writes.

use std::io::Write as _;
use std::path::Path;

use anyhow::Context as _;

/// Writes a file atomically.
///
/// # Errors
/// The operating system's error.
pub fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let failed = || format!("cannot write {}", path.display());
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
