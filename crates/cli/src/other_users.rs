//! Fleets of other users of this host. The default root has the user's id in its name, so that
//! what another one runs is looked for in vain.

use std::fs;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

/// The root of another user who runs a program of joulebus. Only that one can read it.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct OtherRoot {
    pub(crate) path: PathBuf,
    pub(crate) uid: u32,
    /// One of those programs.
    pub(crate) pid: u32,
}

/// Remedy if the fleet of another user is wanted.
pub(crate) const REMEDY: &str = "run as that user, or give both users' configs one `domain.root`. \
    `joulebus serve --socket PATH` and `--http` pass a fleet on to other users";

/// The roots beside `root` that differ from it by the user's id alone, of users who run joulebus.
pub(crate) fn other_roots(root: &Path) -> Vec<OtherRoot> {
    let own = rustix::process::getuid().as_raw();
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

impl std::fmt::Display for OtherRoot {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { path, uid, pid } = self;
        let path = path.display();
        write!(out, "{path} is of uid {uid}, whose joulebus runs (pid {pid})")
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::chown;
    use std::os::unix::process::CommandExt as _;
    use std::process::Command;

    use super::*;

    /// A user whom no system has.
    const UID: u32 = 3_141_592;

    #[test]
    fn the_root_of_another_user_is_named_while_that_one_runs_joulebus() {
        let folder = tempfile::tempdir().unwrap();
        let own = rustix::process::getuid().as_raw();
        let at = |name: String| folder.path().join(name);
        let root = at(format!("joulebus-{own}"));
        let theirs = at(format!("joulebus-{UID}"));
        for path in [&root, &theirs, &at(format!("joulebus-{}", UID + 1))] {
            fs::create_dir(path).unwrap();
        }
        assert_eq!(other_roots(&root), []);
        if chown(&theirs, Some(UID), None).is_err() {
            eprintln!("SKIPPED: only root may give a folder to another user");
            return;
        }
        assert_eq!(other_roots(&root), []);
        let program = at("joulebus-test".to_owned());
        fs::copy("/bin/sleep", &program).unwrap();
        rustix::fs::chmod(folder.path(), rustix::fs::Mode::from_raw_mode(0o755)).unwrap();
        let mut child = Command::new(&program).arg("60").uid(UID).spawn().unwrap();
        let (path, uid, pid) = (theirs, UID, child.id());
        assert_eq!(other_roots(&root), [OtherRoot { path, uid, pid }]);
        assert_eq!(other_roots(&at("elsewhere".to_owned())), []);
        child.kill().unwrap();
        child.wait().unwrap();
    }
}
