//! Where a demonstration lives: a private directory in memory, gone when it ends.

use std::fs::{self, File};
use std::io::Write as _;
use std::os::unix::fs::{DirBuilderExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use joulebus_bus::{Domain, inspect, sweep};
use joulebus_config::{Config, Demo};
use rustix::fs::{FlockOperation, flock};
use serde::Serialize;

const FLEET: &str = "demo";
const PREFIX: &str = "jbd_";
const CONFIG: &str = "demo.toml";

/// The directory and the config of one demonstration. The config's file is locked for as long as
/// it runs, so that others can tell a dead one's.
pub(super) struct Place {
    root: PathBuf,
    domain: Domain,
    config: Config,
    _lock: File,
}

/// What a demonstration has left in shared memory: nothing, or something is wrong.
#[derive(Debug, Default, Clone, Serialize)]
pub(crate) struct LeftBehind {
    /// Objects.
    pub(crate) objects: u64,
    /// Nodes.
    pub(crate) nodes: usize,
    /// Whether the directory is still there.
    pub(crate) directory: bool,
}

impl LeftBehind {
    /// Whether that is nothing.
    pub(crate) const fn is_nothing(&self) -> bool {
        self.objects == 0 && self.nodes == 0 && !self.directory
    }
}

impl Place {
    /// Makes the directory and writes the config; first removes what killed ones have left.
    pub(super) fn make(robots: u32) -> anyhow::Result<Self> {
        remove_dead();
        let root = PathBuf::from(format!("{}-{}", stem(), std::process::id()));
        let demo = Demo {
            fleet: FLEET.to_owned(),
            root: root.clone(),
            prefix: PREFIX.to_owned(),
            robots,
        };
        // Of a killed one with this process id it would have been removed: it is somebody's.
        fs::DirBuilder::new()
            .mode(0o700)
            .create(&root)
            .with_context(|| format!("cannot make {}", root.display()))?;
        let file = root.join(CONFIG);
        let written = write_locked(&file, &demo.toml());
        let lock = written.with_context(|| format!("cannot write {}", file.display()))?;
        let config = Config::load(&file).context("the config that ships was refused")?;
        Ok(Self {
            domain: config.domain()?,
            root,
            config,
            _lock: lock,
        })
    }

    /// The config.
    pub(super) const fn config(&self) -> &Config {
        &self.config
    }

    /// Its file, for the other processes.
    pub(super) fn file(&self) -> PathBuf {
        self.root.join(CONFIG)
    }

    /// Removes everything. All processes must have been waited for. Tells what stays all the same.
    pub(super) fn clear(self) -> anyhow::Result<LeftBehind> {
        clear(&self.domain, &self.root);
        let left = inspect(&self.domain)?;
        Ok(LeftBehind {
            objects: left.objects,
            nodes: left.nodes.len(),
            directory: self.root.exists(),
        })
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        clear(&self.domain, &self.root);
    }
}

fn clear(domain: &Domain, root: &Path) {
    if !root.exists() {
        return;
    }
    if let Err(error) = sweep(domain) {
        tracing::warn!(%error, "something stays in shared memory");
    }
    let _ = fs::remove_file(root.join(CONFIG));
    // Fails if something stays in it, which is then told.
    let _ = fs::remove_dir(root);
}

/// How the directories of this user's demonstrations begin.
fn stem() -> String {
    format!("{}-demo", Domain::default_root().display())
}

fn write_locked(path: &Path, text: &str) -> std::io::Result<File> {
    let mut file = fs::OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(0o600)
        .open(path)?;
    flock(&file, FlockOperation::NonBlockingLockExclusive)?;
    file.write_all(text.as_bytes())?;
    Ok(file)
}

/// Removes what killed demonstrations have left.
fn remove_dead() {
    let stem = PathBuf::from(format!("{}-", stem()));
    let (Some(directory), Some(begin)) = (stem.parent(), stem.file_name()) else {
        return;
    };
    let entries = fs::read_dir(directory).into_iter().flatten().flatten();
    for entry in entries {
        let name = entry.file_name();
        if name
            .as_encoded_bytes()
            .starts_with(begin.as_encoded_bytes())
        {
            remove_if_dead(&entry.path());
        }
    }
}

fn remove_if_dead(root: &Path) {
    // Held until the directory is gone: two newcomers do not clean up at once.
    let lock = File::open(root.join(CONFIG));
    if let Ok(file) = &lock
        && flock(file, FlockOperation::NonBlockingLockExclusive).is_err()
    {
        return;
    }
    let Ok(domain) = Domain::new(FLEET, root, PREFIX) else {
        return;
    };
    // Its processes notice its end by themselves, and may be about to end.
    let lives = inspect(&domain).map_or(true, |found| {
        found.worker_pid.is_some() || found.nodes.iter().any(|node| node.alive != Some(false))
    });
    // A directory without a config may be one that is just being made.
    if !lives && lock.is_ok() {
        tracing::info!(root = %root.display(), "removed what a killed demonstration had left");
        clear(&domain, root);
    }
}
