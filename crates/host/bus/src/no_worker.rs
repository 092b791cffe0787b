//! What an operator is told where no worker is seen: how to start one, or whose fleet there is
//! instead. The default root has the user's id in its name, so a user looks in vain for what
//! another one runs.

use std::fmt;
use std::fs;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

use crate::marker::ROOT_MARKER;
use crate::os::files::effective_uid;
use crate::private::check_private;
use crate::{Domain, WorkerLock};
use joulebus_settings::{FLEET_MARKER, SHM_DIR};

/// A fleet without a worker on this host. Shown, it names the remedy.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NoWorker {
    fleet: String,
    root: PathBuf,
    others: Vec<OtherRoot>,
}

impl NoWorker {
    /// Looks for a worker of the fleet, or for a link in its place. `None` if there is one.
    ///
    /// A lock that cannot be read counts as none: what opens the fleet next says why.
    #[must_use]
    pub fn look(domain: &Domain) -> Option<Self> {
        match WorkerLock::owner(domain) {
            Ok(Some(_)) => None,
            Ok(None) | Err(_) => Some(Self::seen_nowhere(domain)),
        }
    }

    /// Where a worker was waited for in vain, whoever holds its lock.
    #[must_use]
    pub fn seen_nowhere(domain: &Domain) -> Self {
        Self {
            fleet: domain.fleet().to_owned(),
            root: domain.root().to_owned(),
            others: other_roots(domain.root()),
        }
    }
}

impl fmt::Display for NoWorker {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { fleet, root, others } = self;
        write!(
            out,
            "no worker serves fleet {fleet} below {}: start one with `joulebus run`, or give the \
             fleet's config with --config. `joulebus doctor` finds the cause",
            root.display()
        )?;
        for other in others {
            write!(out, ". {other}: {}", other.remedy())?;
        }
        Ok(())
    }
}

/// The root of another user who runs a program of joulebus. Only that one can read it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OtherRoot {
    path: PathBuf,
    uid: u32,
    /// One of those programs.
    pid: u32,
}

impl OtherRoot {
    /// Remedy if the fleet of that user is wanted.
    #[must_use]
    pub fn remedy(&self) -> String {
        let uid = self.uid;
        let command = match self.user() {
            Some(user) => format!("su -s /bin/sh {user} -c 'joulebus …'"),
            None => format!("setpriv --reuid {uid} --clear-groups joulebus …"),
        };
        format!(
            "run this as that user (root: `{command}`), or have that user pass the fleet on with \
             `joulebus serve --socket PATH` or `--http ADDRESS`"
        )
    }

    /// The user's name, if it has one.
    fn user(&self) -> Option<String> {
        let all = fs::read_to_string("/etc/passwd").unwrap_or_default();
        let uid = self.uid.to_string();
        let own = all.lines().find(|line| line.split(':').nth(2) == Some(uid.as_str()));
        own.and_then(|line| line.split(':').next()).map(str::to_owned)
    }
}

/// Roots below /dev/shm that belong to this user and were made by joulebus.
#[must_use]
pub fn own_roots() -> Vec<PathBuf> {
    let entries = fs::read_dir(SHM_DIR).into_iter().flatten().flatten();
    let folders = entries.map(|entry| entry.path()).filter(|path| check_private(path).is_ok());
    let mut roots: Vec<PathBuf> = folders.filter(|path| path.join(ROOT_MARKER).is_file()).collect();
    roots.sort();
    roots
}

/// Names of the fleets below a root of this user.
#[must_use]
pub fn fleets_below(root: &Path) -> Vec<String> {
    let entries = fs::read_dir(root).into_iter().flatten().flatten();
    let fleets = entries.filter(|entry| entry.path().join(FLEET_MARKER).is_file());
    let mut names: Vec<String> =
        fleets.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    names.sort();
    names
}

/// The roots beside `root` that differ from it by the user's id alone, of users who run joulebus.
#[must_use]
pub fn other_roots(root: &Path) -> Vec<OtherRoot> {
    let own = effective_uid();
    let (Some(folder), Some(name)) = (root.parent(), root.file_name()) else {
        return Vec::new();
    };
    let name = name.to_string_lossy();
    let Some(prefix) = name.strip_suffix(&own.to_string()) else {
        return Vec::new();
    };
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut found: Vec<OtherRoot> = entries
        .filter_map(|entry| {
            let name = entry.file_name();
            let uid: u32 = name.to_str()?.strip_prefix(prefix)?.parse().ok()?;
            let metadata = entry.metadata().ok()?;
            let is_root = uid != own && metadata.is_dir() && metadata.uid() == uid;
            let pid = is_root.then(|| process_of(uid)).flatten()?;
            let path = entry.path();
            Some(OtherRoot { path, uid, pid })
        })
        .collect();
    found.sort_by_key(|other| other.uid);
    found
}

fn process_of(uid: u32) -> Option<u32> {
    let entries = fs::read_dir("/proc").into_iter().flatten().flatten();
    let mut theirs =
        entries.filter(|entry| entry.metadata().is_ok_and(|metadata| metadata.uid() == uid));
    theirs.find_map(|entry| {
        let pid = entry.file_name().to_str()?.parse().ok()?;
        let name = fs::read_to_string(entry.path().join("comm")).ok()?;
        name.starts_with("joulebus").then_some(pid)
    })
}

impl fmt::Display for OtherRoot {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { path, uid, pid } = self;
        let path = path.display();
        let user = self.user().unwrap_or_else(|| self.uid.to_string());
        write!(out, "{path} is of {user} (uid {uid}), whose joulebus runs (pid {pid})")
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{PermissionsExt as _, chown};
    use std::os::unix::process::CommandExt as _;
    use std::process::Command;

    use super::*;

    /// A user whom no system has.
    const UID: u32 = 3_141_592;

    #[test]
    fn the_root_of_another_user_is_named_while_that_one_runs_joulebus() {
        let folder = std::env::temp_dir().join(format!("jb-others-{}", std::process::id()));
        fs::create_dir(&folder).unwrap();
        let own = effective_uid();
        let at = |name: String| folder.join(name);
        let root = at(format!("joulebus-{own}"));
        let theirs = at(format!("joulebus-{UID}"));
        for path in [&root, &theirs, &at(format!("joulebus-{}", UID + 1))] {
            fs::create_dir(path).unwrap();
        }
        assert_eq!(other_roots(&root), []);
        if chown(&theirs, Some(UID), None).is_err() {
            let why = "only root may give a folder to another user";
            assert!(std::env::var("CI").as_deref() != Ok("true"), "{why}");
            eprintln!("SKIPPED: {why}");
            return fs::remove_dir_all(&folder).unwrap();
        }
        assert_eq!(other_roots(&root), []);
        let program = at("joulebus-test".to_owned());
        fs::copy("/bin/sleep", &program).unwrap();
        fs::set_permissions(&folder, fs::Permissions::from_mode(0o755)).unwrap();
        let mut child = Command::new(&program).arg("60").uid(UID).spawn().unwrap();
        let (path, uid, pid) = (theirs, UID, child.id());
        assert_eq!(other_roots(&root), [OtherRoot { path, uid, pid }]);
        assert_eq!(other_roots(&at("elsewhere".to_owned())), []);
        child.kill().unwrap();
        child.wait().unwrap();
        fs::remove_dir_all(&folder).unwrap();
    }
}
