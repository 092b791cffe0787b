//! Places of a service: planners and views leave those of the members that must not be kept out.

use iceoryx2::identifiers::UniqueNodeId;
use iceoryx2::node::{Node, NodeState, NodeView as _};
use iceoryx2::prelude::CallbackProgression;
use joulebus_wire::Service;

use super::service::OpenError;
use crate::Bus;
use crate::bus::is_own;
use crate::ipc::Ipc;

/// Whether the bus may keep the port that it has just made, one of those on `nodes`, where others
/// than the product's own may have `places`.
pub(super) fn is_admitted(bus: &Bus, places: usize, nodes: &[UniqueNodeId]) -> bool {
    bus.is_own || nodes.len() <= places || others(bus, nodes).len() <= places
}

/// Why there is no place: who has those that there are.
pub(super) fn taken(bus: &Bus, service: Service, nodes: &[UniqueNodeId]) -> OpenError {
    let mut holders = others(bus, nodes);
    let allowed = holders.len();
    holders.sort();
    holders.dedup();
    OpenError::Places {
        service: service.name(),
        allowed,
        holders: holders.join(", "),
    }
}

/// The holders of ports on `nodes`, but for the product's own, each with name and pid.
fn others(bus: &Bus, nodes: &[UniqueNodeId]) -> Vec<String> {
    let mut known = Vec::new();
    // What cannot be listed is nobody's own.
    let _ = Node::<Ipc>::list(&bus.member.config, |node| {
        let (id, details) = match &node {
            NodeState::Alive(view) => (view.id(), view.details().as_ref()),
            NodeState::Dead(view) => (view.id(), view.details().as_ref()),
            NodeState::Inaccessible(id) | NodeState::Undefined(id) => (id, None),
        };
        let known_of = details.map_or(("?".to_owned(), 0), |details| {
            (details.name().to_string(), details.process_id().value())
        });
        known.push((*id, known_of));
        CallbackProgression::Continue
    });
    let named = |node: &UniqueNodeId| {
        let of_node = known.iter().find(|(id, _)| id == node);
        let (name, pid) = of_node.map_or(("?", 0), |(_, (name, pid))| (name.as_str(), *pid));
        (!is_own(name)).then(|| format!("{name} (pid {pid})"))
    };
    nodes.iter().filter_map(named).collect()
}
