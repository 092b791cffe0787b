//! Places of a service: planners and views leave those of the members that must not be kept out.

use std::fmt::Display;
use std::time::Duration;

use iceoryx2::identifiers::UniqueNodeId;
use iceoryx2::node::{Node, NodeState, NodeView as _};
use iceoryx2::prelude::CallbackProgression;
use joulebus_wire::Service;

use super::service::OpenError;
use crate::Bus;
use crate::bus::is_own;
use crate::clock;
use crate::ipc::Ipc;

/// Tries of two that come at once for the last place.
const TRIES: u64 = 4;

/// Ports of a service of which others than the product's own may have so many; `None`: any number.
pub(super) struct Places<'a, N> {
    pub(super) bus: &'a Bus,
    pub(super) service: Service,
    pub(super) open: Option<usize>,
    /// The nodes that have a port, one for each.
    pub(super) nodes: N,
}

impl<N: Fn() -> Vec<UniqueNodeId>> Places<'_, N> {
    /// Makes a port that may stay; else `full`. Who comes where all are taken makes none, and who
    /// was one too many gives it back.
    pub(super) fn enter<P, E>(
        &self,
        make: impl Fn() -> Result<P, E>,
        full: impl Fn() -> E,
    ) -> Result<P, E> {
        let Some(open) = self.open.filter(|_| !self.bus.is_own) else {
            return make();
        };
        let fits = |more: usize| {
            let nodes = (self.nodes)();
            let room = open.saturating_sub(more);
            nodes.len() <= room || others(self.bus, &nodes).len() <= room
        };
        for number in 0..TRIES {
            if !fits(1) {
                break;
            }
            let port = make()?;
            if fits(0) {
                return Ok(port);
            }
            drop(port);
            // Another time than the other's.
            let apart_us = clock::monotonic_ns() % 4_096;
            std::thread::sleep(Duration::from_micros((number + 1) * apart_us));
        }
        Err(full())
    }

    /// Why there is no place: who has those that there are.
    pub(super) fn refused(&self, reason: impl Display) -> OpenError {
        let Some(allowed) = self.open.filter(|_| !self.bus.is_own) else {
            return OpenError::port(self.service, reason);
        };
        let mut holders = others(self.bus, &(self.nodes)());
        holders.sort();
        holders.dedup();
        OpenError::Places { service: self.service.name(), allowed, holders: holders.join(", ") }
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
