//! The private directory of a demo, in memory, removed at its end.

use std::fs::{self, File};
use std::io::Write as _;
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context as _;
use joulebus_bus::{Domain, inspect, sweep};
use joulebus_config::{Config, Demo, default_root};
use rustix::fs::{FlockOperation, flock};
use serde::Serialize;

const FLEET: &str = "demo";
const PREFIX: &str = "jbd_";
const CONFIG: &str = "demo.toml";
/// Longer than it takes to write the config.
const UNFINISHED_AFTER: Duration = Duration::from_secs(60);

/// The directory and the config of one demo. The config file is locked while it runs, so that
/// directories of dead demos can be identified.
pub(super) struct DemoDirectory {
    root: PathBuf,
    domain: Domain,
    config: Config,
    _lock: File,
}

/// Objects that a demo has left in shared memory: none, unless something is wrong.
#[derive(Debug, Default, Clone, Serialize)]
pub(crate) struct LeftBehind {
    pub(crate) objects: u64,
    pub(crate) nodes: usize,
    /// True if the directory still exists.
    pub(crate) directory: bool,
}

impl LeftBehind {
    /// True if nothing is left.
    pub(crate) const fn is_nothing(&self) -> bool {
        self.objects == 0 && self.nodes == 0 && !self.directory
    }
}

impl DemoDirectory {
    /// Creates the directory and writes the config. First removes the remains of killed demos.
    pub(super) fn make(robots: u32) -> anyhow::Result<Self> {
        remove_dead();
        let root = PathBuf::from(format!("{}-{}", stem(), std::process::id()));
        let demo =
            Demo { fleet: FLEET.to_owned(), root: root.clone(), prefix: PREFIX.to_owned(), robots };
        // A killed demo's folder with this process id would be gone: this one belongs to a live
        // one.
        fs::DirBuilder::new()
            .mode(0o700)
            .create(&root)
            .with_context(|| format!("cannot make {}", root.display()))?;
        let file = root.join(CONFIG);
        let written = write_locked(&file, &demo.toml());
        let lock = written.with_context(|| format!("cannot write {}", file.display()))?;
        let config = Config::load(&file).context("the built-in config was refused")?;
        Ok(Self { domain: config.domain()?, root, config, _lock: lock })
    }

    pub(super) const fn config(&self) -> &Config {
        &self.config
    }

    /// The config's file, for the other processes.
    pub(super) fn file(&self) -> PathBuf {
        self.root.join(CONFIG)
    }

    /// Removes everything, and the remains of demos killed since. All processes must have been
    /// waited for. Returns what could not be removed.
    pub(super) fn clear(self) -> anyhow::Result<LeftBehind> {
        clear(&self.domain, &self.root);
        // Processes of one killed just before this one may still have run when it started.
        remove_dead();
        let left = inspect(&self.domain)?;
        Ok(LeftBehind {
            objects: left.objects,
            nodes: left.nodes.len(),
            directory: self.root.exists(),
        })
    }
}

impl Drop for DemoDirectory {
    fn drop(&mut self) {
        clear(&self.domain, &self.root);
    }
}

fn clear(domain: &Domain, root: &Path) {
    if !root.exists() {
        return;
    }
    if let Err(error) = sweep(domain) {
        tracing::warn!(%error, "shared memory could not be cleaned up");
    }
    // The config stays while other files are left: by it the next demo recognises the directory.
    let mut left = fs::read_dir(root).into_iter().flatten().flatten();
    if left.all(|entry| entry.file_name() == CONFIG) {
        let _ = fs::remove_file(root.join(CONFIG));
        let _ = fs::remove_dir(root);
    }
}

/// Common prefix of the directories of this user's demos.
fn stem() -> String {
    format!("{}-demo", default_root().display())
}

fn write_locked(path: &Path, text: &str) -> std::io::Result<File> {
    let mut file = fs::OpenOptions::new().write(true).create_new(true).mode(0o600).open(path)?;
    flock(&file, FlockOperation::NonBlockingLockExclusive)?;
    file.write_all(text.as_bytes())?;
    Ok(file)
}

/// Removes the directories of killed demos.
fn remove_dead() {
    let stem = PathBuf::from(format!("{}-", stem()));
    let (Some(directory), Some(begin)) = (stem.parent(), stem.file_name()) else {
        return;
    };
    let entries = fs::read_dir(directory).into_iter().flatten().flatten();
    for entry in entries {
        let name = entry.file_name();
        let number = name.to_str().zip(begin.to_str());
        let number = number.and_then(|(name, begin)| name.strip_prefix(begin));
        if number.is_none_or(|number| number.parse::<u32>().is_err()) {
            continue;
        }
        let root = entry.path();
        if is_demo(&root) {
            remove_if_dead(&root);
        } else {
            remove_unfinished(&root);
        }
    }
}

/// True if a directory is a demonstration's: no link, and with a config that states so.
fn is_demo(root: &Path) -> bool {
    let file = root.join(CONFIG);
    let is_plain = fs::symlink_metadata(root).is_ok_and(|found| found.is_dir())
        && fs::symlink_metadata(&file).is_ok_and(|found| found.is_file());
    let line = format!("root = \"{}\"", root.display());
    is_plain && fs::read_to_string(&file).is_ok_and(|text| text.contains(&line))
}

fn remove_if_dead(root: &Path) {
    let Ok(config) = File::open(root.join(CONFIG)) else {
        return;
    };
    // A live demo holds it exclusively. Shared, so that demos that look at once both succeed.
    if flock(&config, FlockOperation::NonBlockingLockShared).is_err() {
        return;
    }
    let Ok(domain) = Domain::new(FLEET, root, PREFIX) else {
        return;
    };
    // Its processes notice its end by themselves, and may be about to exit.
    let lives = inspect(&domain).map_or(true, |found| {
        found.worker.is_some() || found.nodes.iter().any(|node| node.alive != Some(false))
    });
    if lives {
        return;
    }
    // Held until the directory is removed: who does not get it leaves that to the demo that has it.
    if let Ok(directory) = File::open(root)
        && flock(&directory, FlockOperation::NonBlockingLockExclusive).is_ok()
        && is_still(&config, root)
    {
        tracing::info!(root = %root.display(), "removed the files of a killed demo");
        clear(&domain, root);
    }
}

/// True if the directory's config is still this file. Another demo may have removed the directory,
/// and a third may have got the same process id, and so the directory's name.
fn is_still(config: &File, root: &Path) -> bool {
    let (Ok(held), Ok(found)) = (config.metadata(), fs::symlink_metadata(root.join(CONFIG))) else {
        return false;
    };
    (held.dev(), held.ino()) == (found.dev(), found.ino())
}

/// Removes a directory without a config, or with an empty one: a demo was killed while it made or
/// removed it. A directory that is being made is younger.
fn remove_unfinished(root: &Path) {
    // Not through a link, by which another user could name any folder.
    let found = fs::symlink_metadata(root).ok().filter(fs::Metadata::is_dir);
    let made = found.and_then(|found| found.modified().ok());
    if made.is_some_and(|made| made.elapsed().is_ok_and(|age| age > UNFINISHED_AFTER)) {
        let file = root.join(CONFIG);
        if fs::symlink_metadata(&file).is_ok_and(|found| found.is_file() && found.len() == 0) {
            let _ = fs::remove_file(&file);
        }
        // Fails if it contains anything else, or is no directory.
        let _ = fs::remove_dir(root);
    }
}
