//! What was begun and never finished, because its creator was killed: objects, services, nodes.
//!
//! iceoryx2 removes nodes of dead processes, but only finished ones, and it cannot tell an
//! unfinished object from one that is just being made. The kernel can: whoever makes or uses
//! something has its file open.

use std::collections::{BTreeMap, HashSet};
use std::fs;
use std::path::PathBuf;

use super::objects::{Identity, OWNER_READ, Object, list, objects, open_files};
use crate::{Domain, RootError};

/// A description (of a service, a node, a port of a node) loses this right when it is finished.
const OWNER_WRITE: u32 = 0o200;
/// The files of a node's monitor: `<prefix><id>.node_monitor<suffix>`.
const MONITOR: &str = ".node_monitor";
const CONTEXT: &str = "_context";
const OWNER_LOCK: &str = "_owner_lock";

/// Objects in shared memory that were not finished in time; their creators may be alive.
pub(crate) fn unfinished(domain: &Domain) -> Result<Vec<PathBuf>, RootError> {
    let unfinished = |object: &Object| object.is_unfinished() && object.is_old();
    let found = objects(domain)?.into_iter().filter(unfinished);
    Ok(found.map(|object| object.path).collect())
}

/// Removes what was created but never finished: who opens an object without a size waits for it for
/// ever, a service half created stays so, nobody cleans up after half a node, and a dead node with a
/// half-written tag of a port or service cannot be removed.
///
/// Only our own, only what is older than 250 ms, and only if no process holds it open. Returns how
/// many were removed.
pub(crate) fn remove_incomplete(domain: &Domain) -> Result<u64, RootError> {
    let mut objects = objects(domain)?;
    objects.retain(|object| object.is_unfinished() && object.is_old());
    let mut descriptions = services(domain);
    descriptions.extend(node_details(domain));
    descriptions.retain(|file| file.mode & OWNER_WRITE != 0 && file.is_old());
    let nodes = unfinished_nodes(domain);
    if objects.is_empty() && descriptions.is_empty() && nodes.is_empty() {
        return Ok(0);
    }
    // Looked at after the candidates: a creator that lives has them open ever since.
    let open = open_files();
    let mut removed = 0;
    objects.retain(|object| !open.contains(&object.identity));
    for object in objects {
        // Finished in the meantime, then it is somebody's.
        let still = Object::new(object.path)
            .is_some_and(|object| object.is_unfinished() && fs::remove_file(&object.path).is_ok());
        removed += u64::from(still);
    }
    removed += remove_unless_open(descriptions, &open);
    for node in nodes {
        if !node.files.iter().any(|file| open.contains(&file.identity)) {
            removed += u64::from(node.remove());
        }
    }
    Ok(removed)
}

/// Removes the description of service `name` if nobody uses it any more: its creator was killed
/// before its shared memory existed, or its last user before the description was removed.
pub(crate) fn remove_abandoned_service(domain: &Domain, name: &str) -> u64 {
    let mut services = services(domain);
    services.retain(|service| {
        let text = fs::read(&service.path).unwrap_or_default();
        let mut parts = text.windows(name.len());
        service.is_old() && parts.any(|part| part == name.as_bytes())
    });
    remove_unless_open(services, &open_files())
}

fn remove_unless_open(files: Vec<Object>, open: &HashSet<Identity>) -> u64 {
    let abandoned = files
        .into_iter()
        .filter(|file| !open.contains(&file.identity));
    abandoned
        .filter(|file| fs::remove_file(&file.path).is_ok())
        .count() as u64
}

/// The descriptions of the domain's services.
fn services(domain: &Domain) -> Vec<Object> {
    list(&domain.directory().join("services"))
        .into_iter()
        .filter_map(Object::new)
        .collect()
}

/// What nodes say about themselves: their details, and tags of their services and ports.
fn node_details(domain: &Domain) -> Vec<Object> {
    list(&domain.directory().join("nodes"))
        .into_iter()
        .flat_map(|node| list(&node))
        .filter_map(Object::new)
        .collect()
}

/// A node on disk: the directory of its details, and the files of its monitor.
#[derive(Default)]
struct HalfNode {
    directory: Option<PathBuf>,
    files: Vec<Object>,
    /// Monitor, finished context, and owner lock: three make a node that iceoryx2 can handle.
    parts: u32,
}

impl HalfNode {
    fn remove(self) -> bool {
        let files = self
            .files
            .iter()
            .all(|file| fs::remove_file(&file.path).is_ok());
        let directory = self
            .directory
            .is_none_or(|path| fs::remove_dir(path).is_ok());
        files && directory
    }
}

/// Nodes whose creator, or cleaner, was killed half-way: they hold no port yet, or no more.
fn unfinished_nodes(domain: &Domain) -> Vec<HalfNode> {
    let mut nodes: BTreeMap<String, HalfNode> = BTreeMap::new();
    for path in list(&domain.directory().join("nodes")) {
        let Some(name) = path.file_name().and_then(|name| name.to_str()) else {
            continue;
        };
        let Some(object) = Object::new(path.clone()) else {
            let node = nodes.entry(name.to_owned()).or_default();
            node.files
                .extend(list(&path).into_iter().filter_map(Object::new));
            node.directory = Some(path);
            continue;
        };
        let Some((id, part)) = name
            .strip_prefix(domain.shm_prefix())
            .and_then(|name| name.split_once(MONITOR))
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
    let unfinished = |node: &HalfNode| node.parts < 3 && node.files.iter().all(Object::is_old);
    nodes.into_values().filter(unfinished).collect()
}
