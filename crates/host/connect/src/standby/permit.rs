//! The permit to serve.

use std::io;
use std::path::{Path, PathBuf};

use joulebus_bus::clock;

use super::files::{remove, replace};

const FIRST_LINE: &str = "joulebus permit 1";
/// A file that is longer is not a permit's, bytes.
const MAX_BYTES: u64 = 512;

/// The permit of this host's worker.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Permit {
    /// Number of the term, from 1, higher than that of every earlier leader.
    pub term: u64,
    /// The worker sends nothing from this instant on, ns since boot with suspend
    /// ([`clock::boot_ns`]).
    pub until_ns: u64,
    /// The lease that it follows from, for a link that starts again. 0 once it has ended.
    pub lease: u64,
}

impl Permit {
    /// True if it allows to send at `now_ns`.
    #[must_use]
    pub const fn holds(&self, now_ns: u64) -> bool {
        now_ns < self.until_ns
    }

    /// Reads the permit in a file. `None` if there is none, or it is of another boot, whose
    /// instants are meaningless now.
    ///
    /// # Errors
    /// [`PermitError`].
    pub fn read(path: &Path) -> Result<Option<Self>, PermitError> {
        let failed = |source| PermitError::Io { path: path.to_owned(), source };
        let bytes = match joulebus_files::read(path, MAX_BYTES) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(failed(error)),
        };
        let boot_id = clock::boot_id().map_err(failed)?;
        let text = str::from_utf8(&bytes).unwrap_or_default();
        let malformed = || PermitError::Malformed {
            path: path.to_owned(),
            found: String::from_utf8_lossy(&bytes).into_owned(),
        };
        let (boot, permit) = parse(text).ok_or_else(malformed)?;
        Ok((boot == boot_id).then_some(permit))
    }

    /// Replaces the permit of this host's worker.
    ///
    /// # Errors
    /// [`PermitError::Io`]. The permit before is in force.
    pub fn write(&self, path: &Path) -> Result<(), PermitError> {
        let written = clock::boot_id().and_then(|boot_id| {
            let text = self.text(&boot_id);
            replace(path, &[text.as_bytes()])
        });
        written.map_err(|source| PermitError::Io { path: path.to_owned(), source })
    }

    /// Withdraws the permit of this host's worker, which ends.
    ///
    /// # Errors
    /// [`PermitError::Io`]. The permit is in force.
    pub fn withdraw(path: &Path) -> Result<(), PermitError> {
        remove(path).map_err(|source| PermitError::Io { path: path.to_owned(), source })
    }

    fn text(&self, boot_id: &str) -> String {
        let Self { term, until_ns, lease } = self;
        format!("{FIRST_LINE}\nboot {boot_id}\nterm {term}\nuntil {until_ns}\nlease {lease}\n")
    }
}

/// The boot and the permit of a text. `None` if it is another one.
fn parse(text: &str) -> Option<(&str, Permit)> {
    let mut lines = text.strip_suffix('\n')?.split('\n');
    if lines.next() != Some(FIRST_LINE) {
        return None;
    }
    let mut value = |name: &str| lines.next()?.strip_prefix(name)?.strip_prefix(' ');
    let boot = value("boot")?;
    let term = value("term")?.parse().ok().filter(|term| *term > 0)?;
    let until_ns = value("until")?.parse().ok()?;
    let lease = value("lease")?.parse().ok()?;
    if lines.next().is_some() {
        return None;
    }
    let permit = Permit { term, until_ns, lease };
    Some((boot, permit))
}

/// Reason that a permit could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum PermitError {
    /// The system call failed.
    #[error("permit {path:?}: {source}")]
    Io { path: PathBuf, source: io::Error },
    /// The file is something else.
    #[error(
        "{path:?} is not a permit, but {found:?}: remove it, and start the link of this host again"
    )]
    Malformed { path: PathBuf, found: String },
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    const SOME: Permit = Permit { term: 7, until_ns: 1_234, lease: u64::MAX };

    #[test]
    fn a_permit_is_read_as_it_was_written_and_withdrawn_whether_or_not_it_is_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("permit-lab");
        assert_eq!(Permit::read(&path).unwrap(), None);
        SOME.write(&path).unwrap();
        assert_eq!(Permit::read(&path).unwrap(), Some(SOME));
        for _ in 0..2 {
            Permit::withdraw(&path).unwrap();
            assert_eq!(Permit::read(&path).unwrap(), None);
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
        assert!(SOME.holds(1_233) && !SOME.holds(1_234));
    }

    #[test]
    fn every_truncated_or_changed_permit_is_refused_or_of_another_boot() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("permit-lab");
        SOME.write(&path).unwrap();
        let whole = fs::read(&path).unwrap();
        for length in 0..whole.len() {
            fs::write(&path, &whole[..length]).unwrap();
            assert!(Permit::read(&path).is_err(), "{length}");
        }
        let text = String::from_utf8(whole).unwrap();
        for (from, to) in [
            ("permit 1", "permit 2"),
            ("term 7", "term 0"),
            ("term 7", "term -7"),
            ("term 7", "term 99999999999999999999"),
            ("until 1234", "until soon"),
            // An operator's permit of an earlier release.
            ("until 1234", "until never"),
            ("lease", "leash"),
        ] {
            let changed = text.replacen(from, to, 1);
            assert_ne!(changed, text);
            fs::write(&path, &changed).unwrap();
            let error = Permit::read(&path).expect_err(to);
            assert!(error.to_string().contains("is not a permit"), "{error}");
        }
        fs::write(&path, format!("{text}more\n")).unwrap();
        assert!(Permit::read(&path).is_err());
        fs::write(&path, text.replacen("boot ", "boot 0", 1)).unwrap();
        assert_eq!(Permit::read(&path).unwrap(), None);
        fs::remove_file(&path).unwrap();
        fs::create_dir(&path).unwrap();
        assert!(matches!(Permit::read(&path), Err(PermitError::Io { .. })));
    }
}
