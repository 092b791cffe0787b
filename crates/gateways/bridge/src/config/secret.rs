//! Reads a password file.

use std::io;
use std::path::Path;

/// Maximum size of the file, bytes.
const MAX_BYTES: u64 = 4_096;

/// Why the file is refused.
#[derive(Debug, thiserror::Error)]
pub(super) enum SecretError {
    #[error("cannot be read: {0}")]
    Read(#[from] io::Error),
    #[error("has an empty first line")]
    Empty,
}

/// The first line of a file that only its owner can read.
pub(super) fn secret(path: &Path) -> Result<String, SecretError> {
    let text = joulebus_files::read_secret(path, MAX_BYTES)?;
    let line = text.lines().next().unwrap_or_default();
    if line.is_empty() {
        return Err(SecretError::Empty);
    }
    Ok(line.to_owned())
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn only_the_first_line_of_a_file_of_its_owner_alone_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("password");
        fs::write(&path, "hush\nmore\n").unwrap();
        for (mode, is_read) in [(0o600, true), (0o400, true), (0o640, false), (0o604, false)] {
            fs::set_permissions(&path, PermissionsExt::from_mode(mode)).unwrap();
            assert_eq!(secret(&path).is_ok(), is_read, "{mode:o}");
        }
        fs::set_permissions(&path, PermissionsExt::from_mode(0o600)).unwrap();
        assert_eq!(secret(&path).unwrap(), "hush");
        fs::write(&path, "\n").unwrap();
        assert!(matches!(secret(&path), Err(SecretError::Empty)));
        assert!(matches!(secret(folder.path()), Err(SecretError::Read(_))));
    }
}
