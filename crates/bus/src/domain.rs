//! The location of a fleet's shared memory, and its access rights.

use std::fs;
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};

use joulebus_wire::fnv1a;

use crate::os::files::{effective_uid, filesystem, is_memory};
use crate::os::memory::SHM_DIR;

/// `sun_path` of a Unix socket has 108 bytes including the terminating zero.
const MAX_SOCKET_PATH_BYTES: usize = 107;
/// A 128-bit port id in decimal, `.event`, and the slashes around the fleet.
const SOCKET_NAME_BYTES: usize = 39 + 6 + 2;
const MAX_FLEET_BYTES: usize = 32;
const MAX_PREFIX_BYTES: usize = 8;
/// The location of one fleet's shared memory: the same in every process of the fleet.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Domain {
    fleet: String,
    root: PathBuf,
    prefix: String,
    shm_prefix: String,
}

impl Domain {
    /// A domain for `fleet` under the private directory `root`. Creates nothing.
    ///
    /// `fleet`: 1 to 32 of `a–z A–Z 0–9 - _`. `root`: absolute, best on a tmpfs. `prefix`: 1 to 8 of
    /// `a–z 0–9 _`; together with a hash of root and fleet it begins the name of every shared-memory
    /// object, so domains never touch each other's.
    ///
    /// # Errors
    /// [`DomainError`] states the value and the allowed ones.
    pub fn new(fleet: &str, root: &Path, prefix: &str) -> Result<Self, DomainError> {
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if fleet.is_empty() || fleet.len() > MAX_FLEET_BYTES || !fleet.chars().all(plain) {
            return Err(DomainError::Fleet {
                found: fleet.to_owned(),
            });
        }
        let small = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
        if prefix.is_empty() || prefix.len() > MAX_PREFIX_BYTES || !prefix.chars().all(small) {
            return Err(DomainError::Prefix {
                found: prefix.to_owned(),
            });
        }
        // The path goes into a configuration file and must mean the same directory however it is
        // written, because its hash separates domains.
        let root: PathBuf = root.components().collect();
        let text = root.to_str().filter(|text| {
            let allowed = |c: char| c.is_ascii_alphanumeric() || "/-_.+@".contains(c);
            root.is_absolute()
                && text.len() > 1
                && text.chars().all(allowed)
                && !text.split('/').any(|part| part == "..")
        });
        let Some(text) = text else {
            return Err(DomainError::Root {
                found: root.clone(),
            });
        };
        let shm_prefix = format!("{prefix}{:08x}_", hash(&[text, fleet]));
        let allowed = MAX_SOCKET_PATH_BYTES - SOCKET_NAME_BYTES - shm_prefix.len() - fleet.len();
        if text.len() > allowed {
            return Err(DomainError::RootTooLong {
                found: text.len(),
                allowed,
                root: root.clone(),
            });
        }
        Ok(Self {
            fleet: fleet.to_owned(),
            prefix: prefix.to_owned(),
            shm_prefix,
            root,
        })
    }

    /// The default root: `/dev/shm/joulebus-<uid>`.
    #[must_use]
    pub fn default_root() -> PathBuf {
        PathBuf::from(format!("{SHM_DIR}/joulebus-{}", effective_uid()))
    }

    /// Name of the fleet.
    #[must_use]
    pub fn fleet(&self) -> &str {
        &self.fleet
    }

    /// The private root directory; it may contain several fleets.
    #[must_use]
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The configured prefix.
    #[must_use]
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// Prefix of the names of this domain's objects in `/dev/shm`.
    #[must_use]
    pub fn shm_prefix(&self) -> &str {
        &self.shm_prefix
    }

    /// The directory of this fleet below the root: iceoryx2's own root path.
    #[must_use]
    pub fn directory(&self) -> PathBuf {
        self.root.join(&self.fleet)
    }

    pub(crate) fn members_file(&self) -> PathBuf {
        self.directory().join("members.lock")
    }

    pub(crate) fn config_file(&self) -> PathBuf {
        self.directory().join("iceoryx2.toml")
    }

    pub(crate) fn worker_file(&self) -> PathBuf {
        self.root.join(format!("worker-{}.lock", self.fleet))
    }

    /// Creates the root directory, and the fleet's below it, with mode 0700 if they are missing,
    /// and checks that they are private. [`crate::Bus::join`] calls it; calling it again is harmless.
    ///
    /// # Errors
    /// [`RootError`] when either is not a directory, belongs to somebody else, or can be entered
    /// by others.
    pub fn prepare(&self) -> Result<Vec<DomainWarning>, RootError> {
        private_directory(&self.root)?;
        private_directory(&self.directory())?;
        self.warnings()
    }

    /// What works, but not as well as it could.
    pub(crate) fn warnings(&self) -> Result<Vec<DomainWarning>, RootError> {
        let filesystem =
            filesystem(&self.root).map_err(|error| RootError::io(&self.root, error))?;
        Ok(if is_memory(filesystem) {
            Vec::new()
        } else {
            vec![DomainWarning::NotInMemory {
                root: self.root.clone(),
                filesystem,
            }]
        })
    }

    /// Like [`Self::prepare`], for the root alone.
    pub(crate) fn prepare_root(&self) -> Result<(), RootError> {
        private_directory(&self.root)
    }

    /// Removes the root directory if it is empty.
    pub(crate) fn remove_root(&self) {
        // Fails while another fleet, or another process of this one, uses it: then it is not empty.
        let _ = fs::remove_dir(&self.root);
    }
}

fn private_directory(path: &Path) -> Result<(), RootError> {
    match fs::DirBuilder::new().mode(0o700).create(path) {
        Ok(()) => {}
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
        Err(error) => return Err(RootError::io(path, error)),
    }
    check_private(path)
}

/// Whether `path` is a directory of this user that no other user can enter.
pub(crate) fn check_private(path: &Path) -> Result<(), RootError> {
    let found = fs::symlink_metadata(path).map_err(|error| RootError::io(path, error))?;
    let path = path.to_owned();
    if found.file_type().is_symlink() {
        return Err(RootError::Symlink { path });
    }
    if !found.is_dir() {
        return Err(RootError::NotADirectory { path });
    }
    let (owner, expected) = (found.uid(), effective_uid());
    if owner != expected {
        return Err(RootError::Owner {
            path,
            found: owner,
            expected,
        });
    }
    let mode = found.mode() & 0o7777;
    if mode & 0o077 != 0 {
        return Err(RootError::Mode { path, found: mode });
    }
    Ok(())
}

/// FNV-1a, folded to 32 bits.
fn hash(parts: &[&str]) -> u32 {
    let hash = fnv1a(parts.iter().flat_map(|part| part.bytes().chain([0])));
    (hash ^ (hash >> 32)) as u32
}

/// Reason that a [`Domain`] is invalid.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DomainError {
    /// The fleet's name.
    #[error("fleet name {found:?}: allowed are 1 to {MAX_FLEET_BYTES} of a-z A-Z 0-9 - _")]
    Fleet {
        /// The name.
        found: String,
    },
    /// The prefix.
    #[error("prefix {found:?}: allowed are 1 to {MAX_PREFIX_BYTES} of a-z 0-9 _")]
    Prefix {
        /// The prefix.
        found: String,
    },
    /// The root path.
    #[error("root {found:?}: must be absolute, not `/`, without `..`, of a-z A-Z 0-9 / - _ . + @")]
    Root {
        /// The path.
        found: PathBuf,
    },
    /// The root path is too long for the names of sockets below it.
    #[error(
        "root {root:?} has {found} bytes, allowed are {allowed}: choose a shorter one, such as \
         /dev/shm/joulebus"
    )]
    RootTooLong {
        /// Bytes of the path.
        found: usize,
        /// Bytes allowed with this fleet and prefix.
        allowed: usize,
        /// The path.
        root: PathBuf,
    },
}

/// Why a root directory is not used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RootError {
    /// A symbolic link could be redirected.
    #[error("{path:?} is a symbolic link; remove it, or set `root` to the directory itself")]
    Symlink {
        /// The path.
        path: PathBuf,
    },
    /// The path is no directory.
    #[error("{path:?} is not a directory; remove it, or set another `root`")]
    NotADirectory {
        /// The path.
        path: PathBuf,
    },
    /// Another user owns it.
    #[error(
        "{path:?} belongs to uid {found}, expected uid {expected}; set another `root`, or have its \
         owner remove it"
    )]
    Owner {
        /// The path.
        path: PathBuf,
        /// Its owner.
        found: u32,
        /// The effective uid of this process.
        expected: u32,
    },
    /// Other users may enter it.
    #[error("{path:?} has mode {found:04o}, allowed is 0700; run `chmod 700 {}`", path.display())]
    Mode {
        /// The path.
        path: PathBuf,
        /// Its permission bits.
        found: u32,
    },
    /// The system refused.
    #[error("{path:?}: {source}")]
    Io {
        /// The path.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

impl RootError {
    pub(crate) fn io(path: &Path, source: io::Error) -> Self {
        Self::Io {
            path: path.to_owned(),
            source,
        }
    }

    /// The last member has removed the directory in the meantime.
    pub(crate) fn vanished(&self) -> bool {
        matches!(self, Self::Io { source, .. } if source.kind() == io::ErrorKind::NotFound)
    }
}

/// What works, but not as well as it could.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum DomainWarning {
    /// The root lies on a disk: joining takes 23 ms instead of 1 ms, and a kill at the start can
    /// leave nodes that only a cold start removes.
    NotInMemory {
        /// The root.
        root: PathBuf,
        /// The filesystem's magic number.
        filesystem: u64,
    },
}

impl std::fmt::Display for DomainWarning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::NotInMemory { root, filesystem } => write!(
                f,
                "{root:?} is not on a tmpfs (filesystem {filesystem:#x}): starts are slower and \
                 stale files more likely; set `root` below /dev/shm or /run/user"
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_checked() {
        let root = Path::new("/dev/shm/j");
        for (fleet, root, prefix, ok) in [
            ("f", root, "jb_", true),
            ("", root, "jb_", false),
            ("a/b", root, "jb_", false),
            (&"x".repeat(33), root, "jb_", false),
            ("f", root, "", false),
            ("f", root, "JB", false),
            ("f", root, "ninebytes", false),
            ("f", Path::new("dev/shm/j"), "jb_", false),
            ("f", Path::new("/"), "jb_", false),
            ("f", Path::new("/dev/../shm"), "jb_", false),
            ("f", Path::new("/dev/shm/a\"b"), "jb_", false),
            (
                "f",
                Path::new(&format!("/{}", "r".repeat(60))),
                "jb_",
                false,
            ),
        ] {
            assert_eq!(
                Domain::new(fleet, root, prefix).is_ok(),
                ok,
                "{fleet} {root:?} {prefix}"
            );
        }
    }

    #[test]
    fn names_in_shared_memory_are_the_same_in_every_version() {
        let domain = Domain::new("lab", Path::new("/dev/shm/joulebus-0"), "jb_").unwrap();
        assert_eq!(domain.shm_prefix(), "jb_e0675357_");
    }

    #[test]
    fn domains_never_share_a_prefix() {
        let domain = |fleet, root: &str| Domain::new(fleet, Path::new(root), "jb_").unwrap();
        let base = domain("a", "/dev/shm/x");
        assert_eq!(base.shm_prefix(), domain("a", "/dev/shm/x/").shm_prefix());
        assert_ne!(base.shm_prefix(), domain("b", "/dev/shm/x").shm_prefix());
        assert_ne!(base.shm_prefix(), domain("a", "/dev/shm/y").shm_prefix());
    }
}
