//! Names of the files that a worker and the link of its host leave each other.

use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

use joulebus_bus::STANDBY_FILES;
use joulebus_config::Config;
use joulebus_files::disk;

/// The files, in the directory of the fleet in shared memory: the last member of the fleet on this
/// host removes them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StandbyFiles {
    /// [`Permit`](super::Permit) of this host's worker.
    pub permit: PathBuf,
    /// [`SavedState`](super::SavedState) of this host's worker while it serves.
    pub keyframe: PathBuf,
    /// [`SavedState`](super::SavedState) of the worker elsewhere that serves.
    pub replica: PathBuf,
}

impl StandbyFiles {
    /// The paths of the fleet of `config` on this host.
    #[must_use]
    pub fn new(config: &Config) -> Self {
        let directory = config.root().join(config.fleet());
        let [permit, keyframe, replica] = STANDBY_FILES.map(|name| directory.join(name));
        Self { permit, keyframe, replica }
    }
}

/// Replaces a file whole: whoever reads it sees the one before or this one.
pub(crate) fn replace(path: &Path, parts: &[&[u8]]) -> io::Result<()> {
    let mut draft = path.as_os_str().to_owned();
    draft.push(".new");
    let draft = PathBuf::from(draft);
    let written = disk::create(&draft).and_then(|mut file| {
        parts.iter().try_for_each(|part| file.write_all(part))?;
        drop(file);
        disk::rename(&draft, path)
    });
    if written.is_err() {
        let _ = disk::remove_file(&draft);
    }
    written
}

/// Removes a file, if it is there.
pub(crate) fn remove(path: &Path) -> io::Result<()> {
    match disk::remove_file(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        removed => removed,
    }
}
