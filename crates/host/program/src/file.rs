//! Files that a program writes.

use std::io::Write as _;
use std::path::Path;

use anyhow::Context as _;

/// Writes a config, a model or a page as a whole, in place of the one that may be there. Pipes and
/// devices are not replaced.
///
/// # Errors
/// As of [`joulebus_files::replace_shared`].
pub fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    joulebus_files::replace_shared(path, |mut file| file.write_all(bytes))
        .with_context(|| format!("cannot write {}", path.display()))
}
