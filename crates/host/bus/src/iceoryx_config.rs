//! iceoryx2's configuration of a domain: given to every node, and written for other programs.

use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::time::Duration;
use std::{fs, io};

use iceoryx2::config::Config;
use iceoryx2::prelude::{FileName, Path as BusPath, SemanticString};
use rustix::fs::OFlags;

use crate::Domain;
use crate::os::files::draft_number;

/// Timeout of iceoryx2 for another process that is creating a service. After it, cleanup and retry.
const CREATION_TIMEOUT_MS: u64 = 300;
/// Name of the file in the directory of a fleet.
const FILE: &str = "iceoryx2.toml";

/// The iceoryx2 configuration of `domain`.
///
/// iceoryx2's global configuration is left to the program that this library is linked into: it is
/// neither set nor read, because reading it initialises it for good. iceoryx2 itself reads it where
/// it cleans up a dead node whose details are missing, so nothing cleans up but
/// [`remove_dead_nodes`](crate::cleanup::dead_nodes::remove_dead_nodes).
pub(crate) fn config_for(domain: &Domain) -> Result<Config, IceoryxConfigError> {
    let refused =
        |what: &'static str| IceoryxConfigError::Refused { what, domain: Box::new(domain.clone()) };
    let mut config = Config::default();
    let global = &mut config.global;
    global.prefix = FileName::new(domain.shm_prefix().as_bytes()).map_err(|_| refused("prefix"))?;
    let directory = domain.directory();
    let root =
        BusPath::new(directory.as_os_str().as_encoded_bytes()).map_err(|_| refused("root path"))?;
    global.set_root_path(&root);
    global.creation_timeout = Duration::from_millis(CREATION_TIMEOUT_MS);
    global.node.cleanup_dead_nodes_on_creation = false;
    global.node.cleanup_dead_nodes_on_destruction = false;
    global.service.cleanup_dead_nodes_on_open = false;
    Ok(config)
}

/// The domain's configuration as a file.
fn config_file(domain: &Domain) -> PathBuf {
    domain.directory().join(FILE)
}

/// Writes the domain's configuration as a file, for iceoryx2's own programs and packages.
pub(crate) fn write_file(domain: &Domain) -> Result<(), IceoryxConfigError> {
    let path = config_file(domain);
    write(&path, &text(domain)).map_err(|source| IceoryxConfigError::Write { path, source })
}

fn text(domain: &Domain) -> String {
    // Both values are checked by `Domain::new`: no character needs escaping.
    format!(
        "# Written by joulebus; the same for every process of the fleet {fleet:?}.\n\
         [global]\nprefix = \"{prefix}\"\nroot-path = \"{root}\"\n\
         [global.creation-timeout]\nsecs = 0\nnanos = {nanos}\n\
         [global.node]\ncleanup-dead-nodes-on-creation = false\n\
         cleanup-dead-nodes-on-destruction = false\n\
         [global.service]\ncleanup-dead-nodes-on-open = false\n",
        nanos = CREATION_TIMEOUT_MS * 1_000_000,
        fleet = domain.fleet(),
        prefix = domain.shm_prefix(),
        root = domain.directory().display(),
    )
}

/// True if `path` is the domain's file, or a temporary one of it.
pub(crate) fn is_config(domain: &Domain, path: &Path) -> bool {
    let (config, name) = (config_file(domain), path.to_string_lossy());
    let Some(rest) = name.strip_prefix(&*config.to_string_lossy()) else {
        return false;
    };
    let mut digits = rest.bytes().filter(|byte| *byte != b'.');
    (rest.is_empty() || rest.starts_with('.')) && digits.all(|byte| byte.is_ascii_digit())
}

/// Written to a draft and renamed: members that read it meanwhile see a complete file or none.
/// Threads of one process may join at the same time, so each draft has a name of its own.
fn write(path: &Path, text: &str) -> io::Result<()> {
    let (pid, draft) = (std::process::id(), draft_number());
    let draft = path.with_extension(format!("toml.{pid}.{draft}"));
    let mut file = fs::OpenOptions::new()
        .write(true)
        .create(true)
        .truncate(true)
        .mode(0o600)
        .custom_flags(OFlags::NOFOLLOW.bits().cast_signed())
        .open(&draft)?;
    file.write_all(text.as_bytes())?;
    drop(file);
    fs::rename(&draft, path)
}

/// Reason that iceoryx2 could not be configured for a domain.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum IceoryxConfigError {
    /// iceoryx2 rejects the name.
    #[error("iceoryx2 refuses the {what} of {domain:?}. Choose a shorter `root` and `fleet`")]
    Refused { what: &'static str, domain: Box<Domain> },
    /// The file could not be written.
    #[error("cannot write {path:?}: {source}")]
    Write { path: PathBuf, source: io::Error },
}

#[cfg(test)]
mod tests {
    use iceoryx2::prelude::FilePath;

    use super::*;

    #[test]
    fn other_programs_read_the_same_configuration_from_the_file() {
        let root = std::env::temp_dir().join(format!("joulebus-config-{}", std::process::id()));
        let domain = Domain::new("lab", &root, "jbcfg_").unwrap();
        fs::create_dir_all(domain.directory()).unwrap();
        write_file(&domain).unwrap();
        let path = config_file(&domain);
        let path = FilePath::new(path.as_os_str().as_encoded_bytes()).unwrap();
        let read = Config::from_file(&path).unwrap();
        assert_eq!(read, config_for(&domain).unwrap());
        fs::remove_dir_all(&root).unwrap();
    }

    #[test]
    fn threads_that_write_the_file_at_the_same_time_do_not_disturb_each_other() {
        let place = format!("joulebus-iceoryx-config-{}", std::process::id());
        let directory = std::env::temp_dir().join(place);
        fs::create_dir_all(&directory).unwrap();
        let path = directory.join(FILE);
        let text = "key = 1\n".repeat(1_000);
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    for _ in 0..200 {
                        write(&path, &text).unwrap();
                        assert_eq!(fs::read_to_string(&path).unwrap(), text);
                    }
                });
            }
        });
        let left: Vec<_> = fs::read_dir(&directory).unwrap().collect();
        assert_eq!(left.len(), 1, "{left:?}");
        fs::remove_dir_all(&directory).unwrap();
    }

    #[test]
    fn only_the_file_and_its_drafts_are_identified_as_such() {
        let domain = Domain::new("fleet", Path::new("/dev/shm/somewhere"), "t_").unwrap();
        let name = |ending: &str| {
            let path = config_file(&domain);
            is_config(&domain, Path::new(&format!("{}{ending}", path.display())))
        };
        for ending in ["", ".7", ".71.0", ".71.12"] {
            assert!(name(ending), "{ending:?}");
        }
        for ending in ["7", ".bak", ".71.x", "~", ".7 1"] {
            assert!(!name(ending), "{ending:?}");
        }
    }
}
