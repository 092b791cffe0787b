//! Directories that iceoryx2 has made in place of removed ones.
//!
//! iceoryx2 makes missing directories for each file, readable for the group. A process that opens a
//! port while the root is removed would thus keep every other one out: the directories have no
//! marker. So the next process marks them.

use std::fs::Metadata;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use crate::cleanup::objects::{NODES, SERVICES, is_of, is_of_node, is_of_worker, list};
use crate::marker::Marked;
use crate::os::files::effective_uid;
use crate::private::{check_own, check_private};
use crate::{Domain, RootError};

/// Permission bits with which others could have put something into a directory.
const OTHERS_WRITE: u32 = 0o022;

/// Marks root and fleet's directory if iceoryx2 has made them again. Returns those that other users
/// could read, with their modes. Nothing below a root that remains refused is changed.
pub(crate) fn adopt(domain: &Domain) -> Result<Vec<(PathBuf, u32)>, RootError> {
    match try_adopt(domain) {
        // The last member has just removed it.
        Err(error) if error.vanished() => Ok(Vec::new()),
        adopted => adopted,
    }
}

fn try_adopt(domain: &Domain) -> Result<Vec<(PathBuf, u32)>, RootError> {
    let made = made_again(domain).into_iter();
    let marked = made.map(|made| Ok((made.path().to_owned(), made.adopt()?)));
    let mut adopted = marked.collect::<Result<Vec<_>, RootError>>()?;
    for (path, mode) in &adopted {
        let (path, mode) = (path.display(), format_args!("{mode:04o}"));
        tracing::warn!(%path, %mode, "iceoryx2 made a removed directory again. It is used");
    }
    adopted.retain(|(_, mode)| mode & 0o077 != 0);
    Ok(adopted)
}

/// The directories that [`adopt`] marks: root and fleet's directory, as far as iceoryx2 has made
/// them again. None below a root that remains refused.
pub(crate) fn made_again(domain: &Domain) -> Vec<Marked> {
    // A private root may be used without a marker.
    let is_refused = check_private(domain.root()).is_err();
    if is_refused && !is_root_made_again(domain) {
        return Vec::new();
    }
    let root = is_refused.then(|| Marked::root(domain));
    root.into_iter().chain(is_made_again(domain).then(|| Marked::fleet(domain))).collect()
}

/// True if the root contains only directories that iceoryx2 has made for fleets, of any name.
fn is_root_made_again(domain: &Domain) -> bool {
    let root = domain.root();
    let is_fleet = |path: &Path, found: &Metadata| {
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        let fleet = Domain::new(name, root, domain.prefix());
        found.is_dir() && fleet.is_ok_and(|fleet| is_made_again(&fleet))
    };
    let has_entries = root.read_dir().is_ok_and(|mut entries| entries.next().is_some());
    has_entries && holds_only(root, is_fleet)
}

/// True if the fleet's directory has no marker, and contains nothing but what iceoryx2 makes for
/// this domain, and what a worker that stands by and a link write there.
fn is_made_again(domain: &Domain) -> bool {
    // First: each start looks here, and a running fleet has many files.
    if domain.members_file().symlink_metadata().is_ok() {
        return false;
    }
    let directory = domain.directory();
    let [nodes, services] = [NODES, SERVICES].map(|inner| directory.join(inner));
    let is_file = |path: &Path, found: &Metadata| !found.is_dir() && is_of(domain, path);
    let is_node = |path: &Path, found: &Metadata| {
        is_file(path, found) || found.is_dir() && is_of_node(path) && holds_only(path, is_file)
    };
    let is_known = |path: &Path, found: &Metadata| match found.is_dir() {
        true if path == nodes => holds_only(path, is_node),
        true => path == services && holds_only(path, is_file),
        // The socket of an event.
        false => is_of(domain, path) || is_of_worker(path),
    };
    (nodes.is_dir() || services.is_dir()) && holds_only(&directory, is_known)
}

/// True if a directory belongs to this user, no other can write into it, and all its entries belong
/// to this user and are known. An entry that vanishes meanwhile does not count.
fn holds_only(directory: &Path, is_known: impl Fn(&Path, &Metadata) -> bool) -> bool {
    let is_ours = check_own(directory).is_ok_and(|found| found.mode() & OTHERS_WRITE == 0);
    let is_known = |path: &PathBuf| match path.symlink_metadata() {
        Ok(found) => {
            found.uid() == effective_uid() && !found.is_symlink() && is_known(path, &found)
        }
        Err(_) => true,
    };
    is_ours && list(directory).iter().all(is_known)
}
