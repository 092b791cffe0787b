//! Objects, services and nodes whose creator was killed before they were complete.
//!
//! iceoryx2 removes complete nodes of dead processes only, and it cannot distinguish an incomplete
//! object from one that is being created (#1771, #364). The kernel can: a process that creates or
//! uses an object has its file open.

use std::collections::{BTreeMap, HashSet};
use std::fs;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::objects::{
    Identity, NODES, OWNER_READ, Object, SERVICES, is_of, is_of_node, list, list_own, objects,
    open_files,
};
use super::removed::SETTLES_WITHIN;
use crate::os::memory::SHM_DIR;
use crate::os::process::lock_holders;
use crate::{Domain, RootError, clock};

/// A static description (of a service, a node, a port of a node) loses this permission once it is
/// complete.
const OWNER_WRITE: u32 = 0o200;
/// The files of a node's monitor: `<prefix><id>.node_monitor<suffix>`.
const MONITOR: &str = ".node_monitor";
/// Time for which a service must have looked abandoned, ns.
const ABANDONED_AFTER_NS: u64 = 250_000_000;
/// Time between two searches for objects that their creators may complete.
const LOOK_AGAIN_AFTER: Duration = Duration::from_millis(250);
const CONTEXT: &str = "_context";
const OWNER_LOCK: &str = "_owner_lock";

/// Objects in shared memory not completed in time. One that a process has open may be completed
/// within [`SETTLES_WITHIN`], for which this waits: its creator may be waiting for a processor.
pub(crate) fn incomplete_objects(domain: &Domain) -> Result<Vec<PathBuf>, RootError> {
    let begin = Instant::now();
    let search = || {
        let mut found = objects(domain)?;
        found.retain(|object| object.is_incomplete() && object.is_old());
        Ok(found)
    };
    let wait = || {
        std::thread::sleep(LOOK_AGAIN_AFTER);
        begin.elapsed() < SETTLES_WITHIN
    };
    let found = not_completed(search, open_files, wait)?;
    Ok(found.into_iter().map(|object| object.path).collect())
}

/// What `search` finds, and finds again as long as `open` has any of it and `wait` returns true.
fn not_completed(
    search: impl Fn() -> Result<Vec<Object>, RootError>,
    open: impl Fn() -> HashSet<Identity>,
    wait: impl Fn() -> bool,
) -> Result<Vec<Object>, RootError> {
    let mut found = search()?;
    let mut is_settled = false;
    while !found.is_empty() && !is_settled {
        let open = open();
        is_settled = !found.iter().any(|object| open.contains(&object.identity)) || !wait();
        // Also at the end: it may have been completed, and closed, before `open` was asked.
        let again: HashSet<Identity> =
            search()?.into_iter().map(|object| object.identity).collect();
        found.retain(|object| again.contains(&object.identity));
    }
    Ok(found)
}

/// Removes incomplete objects, services and nodes: opening an object of size 0 blocks forever, an
/// incomplete service is never completed, iceoryx2 ignores an incomplete node, and cannot remove a
/// dead node with an incomplete tag of a port or service.
///
/// Restricted to objects of this user that are older than 250 ms and that no process has open.
/// Returns the number of removed objects.
pub(crate) fn remove_incomplete(domain: &Domain) -> Result<u64, RootError> {
    Ok(Candidates::find(domain)?.remove())
}

/// Repeats the search, without directories that have not changed: whatever becomes incomplete adds
/// a name to one of them. A search costs some 200 system calls, four times a second per member.
#[derive(Debug, Default)]
pub(super) struct Search {
    /// The directories before the last search, with what changes when a name is added.
    seen: Vec<(PathBuf, Change)>,
    /// The last two searches found nothing. One is not enough: a name may be added at the instant
    /// of a search, while the clock of the file system stands still.
    is_settled: bool,
    passed_over: u32,
}

/// Device and inode of a directory, and when it was changed, s and ns.
type Change = Option<(u64, u64, i64, i64)>;

/// Searches in a row that are passed over: somebody may have changed a file itself.
const MAX_PASSED_OVER: u32 = 15;

impl Search {
    /// As [`remove_incomplete`].
    pub(super) fn remove(&mut self, domain: &Domain) -> Result<u64, RootError> {
        if self.is_settled && self.passed_over < MAX_PASSED_OVER {
            let is_same = |(path, seen): &(PathBuf, Change)| change(path) == *seen;
            if self.seen.iter().all(is_same) {
                self.passed_over += 1;
                return Ok(0);
            }
        }
        let before = directories(domain);
        let found = Candidates::find(domain)?;
        self.is_settled = found.is_empty() && before == self.seen;
        (self.seen, self.passed_over) = (before, 0);
        Ok(found.remove())
    }
}

/// The directories in which something can be incomplete.
fn directories(domain: &Domain) -> Vec<(PathBuf, Change)> {
    let [nodes, services] = [NODES, SERVICES].map(|inner| domain.directory().join(inner));
    let details = list_own(&nodes);
    let details = details.into_iter().filter(|path| is_of_node(path));
    let all = [PathBuf::from(SHM_DIR), services, nodes.clone()];
    let with_change = |path: PathBuf| {
        let change = change(&path);
        (path, change)
    };
    all.into_iter().chain(details).map(with_change).collect()
}

fn change(directory: &Path) -> Change {
    let found = fs::symlink_metadata(directory).ok()?;
    Some((found.dev(), found.ino(), found.mtime(), found.mtime_nsec()))
}

/// Incomplete objects of any age: only old ones are removed.
struct Candidates {
    objects: Vec<Object>,
    descriptions: Vec<Object>,
    nodes: Vec<NodeFiles>,
}

impl Candidates {
    fn find(domain: &Domain) -> Result<Self, RootError> {
        let mut objects = objects(domain)?;
        objects.retain(Object::is_incomplete);
        let mut descriptions = services(domain);
        descriptions.extend(node_details(domain));
        descriptions.retain(|file| file.mode & OWNER_WRITE != 0);
        let nodes = incomplete_nodes(domain);
        Ok(Self { objects, descriptions, nodes })
    }

    fn is_empty(&self) -> bool {
        self.objects.is_empty() && self.descriptions.is_empty() && self.nodes.is_empty()
    }

    /// Removes what is old and open in no process. Returns the number removed.
    fn remove(self) -> u64 {
        let Self { mut objects, mut descriptions, mut nodes } = self;
        objects.retain(Object::is_old);
        descriptions.retain(Object::is_old);
        nodes.retain(NodeFiles::is_old);
        if objects.is_empty() && descriptions.is_empty() && nodes.is_empty() {
            return 0;
        }
        // Read after the candidates: a live creator has had them open since before.
        let open = open_files();
        let mut removed = 0;
        objects.retain(|object| !open.contains(&object.identity));
        descriptions.retain(|file| !open.contains(&file.identity));
        for object in objects.into_iter().chain(descriptions) {
            removed += u64::from(object.remove());
        }
        for node in nodes {
            if !node.files.iter().any(|file| open.contains(&file.identity)) {
                removed += u64::from(node.remove());
            }
        }
        removed
    }
}

/// Descriptions of services that looked abandoned, and since when, monotonic ns.
#[derive(Debug, Default)]
pub(crate) struct Abandoned {
    seen: Vec<(Identity, u64)>,
}

impl Abandoned {
    /// Removes the description of service `name` once no process has used it for a quarter of a
    /// second. To be called repeatedly. Returns the number removed.
    ///
    /// Its creator was killed before its shared memory existed, or its last user before removing
    /// the description. A user that is just leaving removes the memory first, and needs a moment.
    /// Without shared memory the description is removed even if a process has it open: it is of no
    /// use.
    ///
    /// iceoryx2's `force_remove_service` (#1584) relies on its caller that nobody uses the service.
    pub(crate) fn remove(&mut self, domain: &Domain, name: &str) -> u64 {
        let mut services = services(domain);
        services.retain(|service| {
            let text = fs::read_to_string(&service.path).unwrap_or_default();
            service.is_old() && text.contains(name)
        });
        let open = open_files();
        services.retain(|service| {
            let text = fs::read_to_string(&service.path).unwrap_or_default();
            let is_empty =
                service.mode & OWNER_WRITE == 0 && !has_ports(domain.shm_prefix(), &text);
            is_empty || !open.contains(&service.identity)
        });
        let now_ns = clock::monotonic_ns();
        self.seen
            .retain(|(identity, _)| services.iter().any(|service| service.identity == *identity));
        services.retain(|service| {
            let since = self.seen.iter().find(|(identity, _)| *identity == service.identity);
            let since_ns = since.map(|(_, since_ns)| *since_ns);
            if since_ns.is_none() {
                self.seen.push((service.identity, now_ns));
            }
            since_ns.is_some_and(|since_ns| now_ns - since_ns >= ABANDONED_AFTER_NS)
        });
        services.into_iter().map(|service| u64::from(service.remove())).sum()
    }
}

/// The processes that have descriptions of services locked, as far as they are visible here: those
/// that make or remove a service. After some time they are stopped.
pub(crate) fn holders(domain: &Domain) -> Vec<u32> {
    let files = services(domain).into_iter();
    let files = files.filter_map(|service| fs::File::open(service.path).ok());
    files.flat_map(|file| lock_holders(&file, None).unwrap_or_default()).collect()
}

/// True if the list of ports of a service with this description exists, as far as the description
/// shows. `prefix`: that of the domain's objects in shared memory.
pub(crate) fn has_ports(prefix: &str, description: &str) -> bool {
    let half = |key: &str| -> Option<u128> {
        let line = description.lines().find_map(|line| line.strip_prefix(key));
        line?.strip_prefix(" = ")?.trim().parse().ok()
    };
    let (Some(low), Some(high)) = (half("payload_value"), half("unique_value")) else {
        return true;
    };
    let ports = format!("_{}.dynamic", high << 64 | low);
    list(Path::new(SHM_DIR)).iter().any(|path| {
        let name = path.file_name().and_then(|name| name.to_str());
        name.is_some_and(|name| name.starts_with(prefix) && name.ends_with(&ports))
    })
}

fn services(domain: &Domain) -> Vec<Object> {
    own_files(domain, &domain.directory().join(SERVICES))
}

/// The details of nodes, and the tags of their services and ports.
fn node_details(domain: &Domain) -> Vec<Object> {
    list_own(&domain.directory().join(NODES))
        .into_iter()
        .filter(|path| is_of_node(path))
        .flat_map(|node| own_files(domain, &node))
        .collect()
}

fn own_files(domain: &Domain, directory: &Path) -> Vec<Object> {
    list_own(directory)
        .into_iter()
        .filter(|path| is_of(domain, path))
        .filter_map(Object::new)
        .collect()
}

/// A node on disk: the directory of its details and the files of its monitor.
#[derive(Default)]
struct NodeFiles {
    directory: Option<Object>,
    files: Vec<Object>,
    /// Monitor, complete context and owner lock: iceoryx2 handles nodes that have all three.
    parts: u32,
}

impl NodeFiles {
    /// The directory counts: it is made first, and is empty for a moment.
    fn is_old(&self) -> bool {
        self.files.iter().chain(&self.directory).all(Object::is_old)
    }

    fn remove(self) -> bool {
        let files = self.files.iter().all(|file| fs::remove_file(&file.path).is_ok());
        let directory =
            self.directory.is_none_or(|directory| fs::remove_dir(directory.path).is_ok());
        files && directory
    }
}

/// Nodes whose creator or remover was killed before it finished: they have no ports.
fn incomplete_nodes(domain: &Domain) -> Vec<NodeFiles> {
    let mut nodes: BTreeMap<String, NodeFiles> = BTreeMap::new();
    for path in list_own(&domain.directory().join(NODES)) {
        let Some(name) = path.file_name().and_then(|name| name.to_str()) else {
            continue;
        };
        if is_of_node(&path) {
            let node = nodes.entry(name.to_owned()).or_default();
            node.files.extend(own_files(domain, &path));
            node.directory = Object::directory(path);
            continue;
        }
        let Some(object) = Object::new(path.clone()) else {
            continue;
        };
        let Some((id, part)) =
            name.strip_prefix(domain.shm_prefix()).and_then(|name| name.split_once(MONITOR))
        else {
            continue;
        };
        let is_whole = match part {
            "" | OWNER_LOCK => true,
            CONTEXT => object.mode & 0o700 == OWNER_READ,
            _ => continue,
        };
        let node = nodes.entry(id.to_owned()).or_default();
        node.parts += u32::from(is_whole);
        node.files.push(object);
    }
    let incomplete = |node: &NodeFiles| node.parts < 3;
    nodes.into_values().filter(incomplete).collect()
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::os::unix::fs::PermissionsExt as _;
    use std::thread::sleep;

    use super::*;

    /// Files of a domain with one node, without iceoryx2.
    fn domain(name: &str) -> Domain {
        let root = std::env::temp_dir().join(format!("joulebus-{name}-{}", std::process::id()));
        let domain = Domain::new("lab", &root, "jbinc_").unwrap();
        for inner in [NODES, SERVICES] {
            fs::create_dir_all(domain.directory().join(inner)).unwrap();
        }
        let nodes = domain.directory().join(NODES);
        fs::create_dir_all(nodes.join("7")).unwrap();
        for part in ["", CONTEXT, OWNER_LOCK] {
            let path = nodes.join(format!("{}7{MONITOR}{part}", domain.shm_prefix()));
            fs::write(&path, "").unwrap();
            fs::set_permissions(&path, fs::Permissions::from_mode(0o400)).unwrap();
        }
        domain
    }

    /// A description that its creator has not completed.
    fn describe(domain: &Domain, directory: &Path, name: &str) -> PathBuf {
        let path = directory.join(format!("{}{name}", domain.shm_prefix()));
        fs::write(&path, "half of it").unwrap();
        path
    }

    fn settle(search: &mut Search, domain: &Domain) {
        // Other programs of this host may add names to /dev/shm meanwhile.
        for _ in 0..1_000 {
            search.remove(domain).unwrap();
            if search.passed_over > 0 {
                return;
            }
            sleep(Duration::from_millis(5));
        }
        panic!("every search finds a change");
    }

    #[test]
    fn what_is_added_after_a_search_that_was_passed_over_is_found_in_each_directory_and_removed_when_it_is_old()
     {
        let domain = domain("settled");
        let mut search = Search::default();
        let [nodes, services] = [NODES, SERVICES].map(|inner| domain.directory().join(inner));
        for directory in [services, nodes.join("7")] {
            settle(&mut search, &domain);
            let path = describe(&domain, &directory, "x.service");
            let at_once = search.remove(&domain).unwrap();
            assert!(!search.is_settled, "{path:?}");
            sleep(Duration::from_millis(300));
            let removed = at_once + search.remove(&domain).unwrap();
            assert_eq!(removed, 1, "{path:?}");
            assert!(!path.exists());
        }
        settle(&mut search, &domain);
        let object = describe(&domain, Path::new(SHM_DIR), "x.data");
        fs::set_permissions(&object, fs::Permissions::from_mode(0o200)).unwrap();
        sleep(Duration::from_millis(300));
        assert_eq!(search.remove(&domain).unwrap(), 1, "{object:?}");
        fs::remove_dir_all(domain.root()).unwrap();
    }

    #[test]
    fn a_file_that_is_changed_without_a_new_name_is_found_after_a_bounded_number_of_searches() {
        let domain = domain("changed");
        let services = domain.directory().join(SERVICES);
        let path = describe(&domain, &services, "x.service");
        let complete = fs::Permissions::from_mode(0o400);
        fs::set_permissions(&path, complete).unwrap();
        let mut search = Search::default();
        settle(&mut search, &domain);
        fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
        sleep(Duration::from_millis(300));
        let removed = (0..=MAX_PASSED_OVER).map(|_| search.remove(&domain).unwrap());
        assert_eq!(removed.sum::<u64>(), 1);
        fs::remove_dir_all(domain.root()).unwrap();
    }

    #[test]
    fn an_object_counts_as_incomplete_if_its_creator_is_gone_or_does_not_complete_it_in_time() {
        let object = |name: &str| {
            let path = std::env::temp_dir().join(format!("joulebus-{name}-{}", std::process::id()));
            fs::write(&path, "").unwrap();
            Object::new(path).unwrap()
        };
        let [slow, dead] = ["slow", "dead"].map(object);
        let both = HashSet::from([slow.identity, dead.identity]);
        // Found at first, open, the search after which `slow` is complete, and what is reported.
        let cases = [
            (vec![], &both, 0, vec![]),
            (vec![&slow], &both, 1, vec![]),
            (vec![&slow], &both, 3, vec![]),
            (vec![&slow], &both, 5, vec![&slow]),
            // Completed and closed after it was found.
            (vec![&slow], &HashSet::new(), 1, vec![]),
            (vec![&slow, &dead], &both, 1, vec![&dead]),
            (vec![&dead], &HashSet::new(), 0, vec![&dead]),
        ];
        for (at_first, open, completed_after, reported) in cases {
            let (searches, waits) = (Cell::new(0), Cell::new(0));
            let search = || {
                searches.set(searches.get() + 1);
                let is_complete = |object: &Object| {
                    object.identity == slow.identity && searches.get() > completed_after
                };
                let found = at_first.iter().map(|object| (*object).clone());
                Ok(found.filter(|object| !is_complete(object)).collect())
            };
            let wait = || {
                waits.set(waits.get() + 1);
                waits.get() < 4
            };
            let found = not_completed(search, || open.clone(), wait).unwrap();
            assert_eq!(found.iter().collect::<Vec<_>>(), reported, "{at_first:?}");
            assert_eq!(waits.get() > 0, !at_first.is_empty() && !open.is_empty());
        }
        for object in [slow, dead] {
            fs::remove_file(object.path).unwrap();
        }
    }

    #[test]
    fn the_directory_of_a_node_that_is_just_being_made_is_kept() {
        let domain = domain("empty");
        let node = domain.directory().join(NODES).join("8");
        fs::create_dir(&node).unwrap();
        assert_eq!(remove_incomplete(&domain).unwrap(), 0);
        assert!(node.exists());
        sleep(Duration::from_millis(300));
        assert_eq!(remove_incomplete(&domain).unwrap(), 1);
        assert!(!node.exists());
        fs::remove_dir_all(domain.root()).unwrap();
    }
}
