//! A fleet's directories: creation and checks.

use std::fs;
use std::io::ErrorKind;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::Domain;
use crate::adopt::adopt;
use crate::cleanup::objects::{NODES, SERVICES};
use crate::marker::Marked;
use crate::os::files::{filesystem, is_memory};
use crate::private::{check_own, check_private};
use crate::{DomainWarning, RootError};

/// Timeout of retries while other processes create or remove the directories.
pub(crate) const RETRY_TIMEOUT: Duration = Duration::from_secs(5);

/// Creates the root directory, and the fleet's below it, with mode 0700 if they are missing.
/// Both must be private, and the fleet's must contain the marker that joulebus writes at its
/// creation: others are not changed, unless iceoryx2 alone made them. Called by
/// [`crate::Bus::join`]. Idempotent.
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

/// Removes other users' rights from the directories that joulebus created, or that iceoryx2 made in
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
