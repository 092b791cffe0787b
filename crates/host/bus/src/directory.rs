//! A fleet's directories: creation and checks.

use std::fs;
use std::io::ErrorKind;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::Domain;
use crate::cleanup::objects::{NODES, SERVICES, is_of, is_of_node, list, list_own};
use crate::marker::Marked;
use crate::os::files::{filesystem, is_memory};
use crate::private::{check_own, check_private};
use crate::{DomainWarning, RootError};

/// Timeout of retries while other processes create or remove the directories.
pub(crate) const RETRY_TIMEOUT: Duration = Duration::from_secs(5);

/// Creates the root directory, and the fleet's below it, with mode 0700 if they are missing.
/// Both must be private, and the fleet's must contain the marker that joulebus writes at its
/// creation: others are not changed. Called by [`crate::Bus::join`]. Idempotent.
///
/// # Errors
/// [`RootError`] if one cannot be created, is not a private directory of this user, or was not
/// created by joulebus.
pub fn prepare_domain(domain: &Domain) -> Result<Vec<DomainWarning>, RootError> {
    prepare_root(domain)?;
    if is_missing(&domain.directory()) {
        Marked::fleet(domain).create()?;
    }
    check(domain)?;
    warnings(domain)
}

/// Removes other users' rights from those of the directories that joulebus created, or iceoryx2 in
/// their place. Returns the changed ones with their previous modes.
///
/// # Errors
/// [`RootError`] if a directory accessible to others was not created by joulebus.
pub fn restrict_domain(domain: &Domain) -> Result<Vec<(PathBuf, u32)>, RootError> {
    let adopted = adopt(domain)?;
    let root = match Marked::root(domain).restrict() {
        // Created by its owner, who gets a message.
        Err(RootError::Unmarked { .. }) => check_private(domain.root()).map(|()| None)?,
        mode => mode?,
    };
    let root = root.map(|mode| (domain.root().to_owned(), mode));
    let fleet = Marked::fleet(domain).restrict()?;
    let fleet = fleet.map(|mode| (domain.directory(), mode));
    Ok(adopted.into_iter().chain(root).chain(fleet).collect())
}

/// Marks directories that iceoryx2 has made in place of removed ones, so that they can be used and
/// cleaned up. It makes missing directories for each file, readable for the group: without this,
/// a process that opens a port while the root is removed would keep every other one out. Returns
/// those that other users could read, with their modes.
fn adopt(domain: &Domain) -> Result<Vec<(PathBuf, u32)>, RootError> {
    let directory = domain.directory();
    if !is_missing(&domain.members_file()) || !is_made_by_iceoryx(domain) {
        return Ok(Vec::new());
    }
    let root = domain.root();
    let mut adopted = Vec::new();
    // A private root may be used without a marker.
    if check_private(root).is_err() && list(root).iter().all(|fleet| holds_only_inner(fleet)) {
        adopted.push((root.to_owned(), Marked::root(domain).adopt()?));
    }
    adopted.push((directory, Marked::fleet(domain).adopt()?));
    tracing::warn!(?adopted, "iceoryx2 has made removed directories again. They are used");
    adopted.retain(|(_, mode)| mode & 0o077 != 0);
    Ok(adopted)
}

/// True if the fleet's directory contains files of iceoryx2 for this domain, and nothing else.
fn is_made_by_iceoryx(domain: &Domain) -> bool {
    let directory = domain.directory();
    if !holds_only_inner(&directory) {
        return false;
    }
    let inner = [NODES, SERVICES].map(|inner| list_own(&directory.join(inner)));
    let mut files = Vec::new();
    for path in inner.into_iter().flatten() {
        if is_of_node(&path) {
            files.extend(list_own(&path));
        } else {
            files.push(path);
        }
    }
    !files.is_empty() && files.iter().all(|path| is_of(domain, path))
}

/// True if a directory of this user contains no other names than those of iceoryx2's directories.
fn holds_only_inner(directory: &Path) -> bool {
    let found = list_own(directory);
    let is_inner = |path: &PathBuf| [NODES, SERVICES].iter().any(|inner| path.ends_with(inner));
    !found.is_empty() && found.iter().all(is_inner)
}

/// Conditions that work with reduced performance.
pub(crate) fn warnings(domain: &Domain) -> Result<Vec<DomainWarning>, RootError> {
    let root = domain.root();
    let filesystem = filesystem(root).map_err(|error| RootError::io(root, error))?;
    Ok(if is_memory(filesystem) {
        Vec::new()
    } else {
        vec![DomainWarning::NotInMemory { root: root.to_owned(), filesystem }]
    })
}

/// Like [`prepare_domain`], for the root only.
pub(crate) fn prepare_root(domain: &Domain) -> Result<(), RootError> {
    adopt(domain)?;
    let root = domain.root();
    if is_missing(root) {
        let parent = root.parent().unwrap_or(Path::new("/"));
        if is_missing(parent) {
            return Err(RootError::NoParent { path: root.to_owned(), parent: parent.to_owned() });
        }
        Marked::root(domain).create()?;
    }
    check_private(root)
}

/// Checks that the fleet's directory was created by joulebus for this fleet, and that nothing
/// in it leads elsewhere. Has no side effects. Returns the boot in which it was created.
pub(crate) fn check(domain: &Domain) -> Result<String, RootError> {
    let boot = Marked::fleet(domain).check()?;
    let directory = domain.directory();
    let device = device(&directory)?;
    if self::device(domain.root())? != device {
        return Err(RootError::MountPoint { path: directory });
    }
    for inner in [NODES, SERVICES] {
        let path = directory.join(inner);
        match check_own(&path) {
            Ok(found) if found.dev() != device => return Err(RootError::MountPoint { path }),
            Ok(_) => {}
            Err(error) if error.vanished() => {}
            Err(error) => return Err(error),
        }
    }
    Ok(boot)
}

/// Removes the root directory if joulebus created it and it is empty. The caller uses nothing
/// in it.
pub(crate) fn remove_root(domain: &Domain) {
    Marked::root(domain).remove();
}

fn is_missing(path: &Path) -> bool {
    let found = fs::symlink_metadata(path);
    found.is_err_and(|error| error.kind() == ErrorKind::NotFound)
}

fn device(path: &Path) -> Result<u64, RootError> {
    let found = fs::symlink_metadata(path).map_err(|error| RootError::io(path, error))?;
    Ok(found.dev())
}
