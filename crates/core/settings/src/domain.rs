//! The location of a fleet's shared memory.

use std::path::{Path, PathBuf};

use joulebus_wire::fnv1a;

/// Directory of the objects in shared memory.
pub const SHM_DIR: &str = "/dev/shm";

/// `sun_path` of a Unix socket has 108 bytes including the terminating zero.
const MAX_SOCKET_PATH_BYTES: usize = 107;
/// A 128-bit port id in decimal, `.event`, and the slashes around the fleet.
const SOCKET_NAME_BYTES: usize = 39 + 6 + 2;
/// The members' lock is the marker of a fleet's directory.
pub const FLEET_MARKER: &str = "members.lock";
/// Names in the fleet's directory of the files that its worker and its host's link share. The last
/// member removes them, and drafts of them, which end in `.new`.
pub const STANDBY_FILES: [&str; 3] = ["permit", "keyframe", "replica"];
/// Name in the fleet's directory of the file with the times at which alarms were raised, which its
/// worker's process writes. The last member removes it, and a draft of it.
pub const RAISES_FILE: &str = "raises";
/// Name of the file with the samples that a worker refuses, in the fleet's directory.
pub const REFUSALS_FILE: &str = "refusals";
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
    /// `fleet`: 1 to 32 of `a–z A–Z 0–9 - _`. `root`: absolute, best on a tmpfs. `prefix`: 1 to 8
    /// of `a–z 0–9 _`. Together with a hash of root and fleet it begins the name of every
    /// shared-memory object, so domains never touch each other's.
    ///
    /// # Errors
    /// [`DomainError`] states the value and the allowed ones.
    pub fn new(fleet: &str, root: &Path, prefix: &str) -> Result<Self, DomainError> {
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if fleet.is_empty() || fleet.len() > MAX_FLEET_BYTES || !fleet.chars().all(plain) {
            return Err(DomainError::Fleet { found: fleet.to_owned() });
        }
        let small = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
        if prefix.is_empty() || prefix.len() > MAX_PREFIX_BYTES || !prefix.chars().all(small) {
            return Err(DomainError::Prefix { found: prefix.to_owned() });
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
            return Err(DomainError::Root { found: root.clone() });
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
        Ok(Self { fleet: fleet.to_owned(), prefix: prefix.to_owned(), shm_prefix, root })
    }

    /// Name of the fleet.
    pub fn fleet(&self) -> &str {
        &self.fleet
    }

    /// The private root directory. It may contain several fleets.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The configured prefix.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// Prefix of the names of this domain's objects in `/dev/shm`.
    pub fn shm_prefix(&self) -> &str {
        &self.shm_prefix
    }

    /// The directory of this fleet below the root: iceoryx2's own root path.
    pub fn directory(&self) -> PathBuf {
        self.root.join(&self.fleet)
    }

    /// The lock that every member holds shared.
    pub fn members_file(&self) -> PathBuf {
        self.directory().join(FLEET_MARKER)
    }

    /// The lock of the worker.
    pub fn worker_file(&self) -> PathBuf {
        self.root.join(format!("worker-{}.lock", self.fleet))
    }
}

/// FNV-1a, folded to 32 bits.
fn hash(parts: &[&str]) -> u32 {
    let hash = fnv1a(parts.iter().flat_map(|part| part.bytes().chain([0])));
    (hash ^ (hash >> 32)) as u32
}

/// Reason that a [`Domain`] is invalid.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum DomainError {
    /// The fleet's name.
    #[error("fleet name {found:?}: allowed are 1 to {MAX_FLEET_BYTES} of a-z A-Z 0-9 - _")]
    Fleet { found: String },
    /// The prefix.
    #[error("prefix {found:?}: allowed are 1 to {MAX_PREFIX_BYTES} of a-z 0-9 _")]
    Prefix { found: String },
    /// The root path.
    #[error("root {found:?}: must be absolute, not `/`, without `..`, of a-z A-Z 0-9 / - _ . + @")]
    Root { found: PathBuf },
    /// The root path is too long for the names of sockets below it.
    #[error(
        "root {root:?} has {found} bytes, allowed are {allowed} with this fleet's name and prefix: \
         choose a shorter one, such as /dev/shm/joulebus"
    )]
    RootTooLong { found: usize, allowed: usize, root: PathBuf },
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
            ("f", Path::new(&format!("/{}", "r".repeat(60))), "jb_", false),
        ] {
            assert_eq!(Domain::new(fleet, root, prefix).is_ok(), ok, "{fleet} {root:?} {prefix}");
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
