//! Places of a service: planners and views leave those of the members that must not be kept out.

use std::fmt::Display;
use std::time::Duration;

use iceoryx2::identifiers::UniqueNodeId;
use iceoryx2::node::{Node, NodeState, NodeView as _};
use iceoryx2::prelude::CallbackProgression;
use joulebus_wire::{Flow, Service};

use super::service::{self, OpenError};
use crate::bus::OWN;
use crate::ipc::Ipc;
use crate::os::fork::ForkSection;
use crate::{Bus, Limits, clock};

/// Tries of two that come at once for the last place.
const TRIES: u64 = 4;

/// Places that anybody may take. Members of the names in `own` have others beside these.
#[derive(Clone, Copy)]
pub(super) struct OpenPlaces {
    pub(super) places: usize,
    pub(super) own: &'static [&'static str],
}

impl OpenPlaces {
    /// Those of a channel. The fleet's own members have others beside them.
    pub(super) fn new(limits: &Limits, flow: Flow) -> Self {
        Self { places: limits.open_places(flow), own: OWN }
    }
}

/// Ports of a service. Without `open` all places are anybody's.
pub(super) struct Places<'a, N> {
    pub(super) bus: &'a Bus,
    pub(super) service: Service,
    pub(super) open: Option<OpenPlaces>,
    /// The nodes that have a port, one for each.
    pub(super) nodes: N,
}

impl<N: Fn() -> Vec<UniqueNodeId>> Places<'_, N> {
    /// Creates a port as [`service::create`] does, where there is a place for it. `full`: the error
    /// of iceoryx2 that all places are taken.
    pub(super) fn create<P, E: Copy + Display + PartialEq>(
        &self,
        make: impl Fn() -> Result<P, E>,
        full: E,
    ) -> Result<P, OpenError> {
        let is_full = |reason: &E| *reason == full;
        let created = service::create(self.bus, || self.enter(&make, full), is_full);
        created.map_err(|reason| match is_full(&reason) {
            true => self.refused(reason),
            false => OpenError::port(self.service, reason),
        })
    }

    /// Makes a port that may stay, else `full`. Who comes where all are taken makes none, and who
    /// was one too many gives it back.
    fn enter<P, E>(&self, make: impl Fn() -> Result<P, E>, full: E) -> Result<P, E> {
        let Some(OpenPlaces { places: open, own }) = self.limit() else {
            return make();
        };
        let fits = |more: usize| {
            let nodes = (self.nodes)();
            let room = open.saturating_sub(more);
            nodes.len() <= room || self.others(own, &nodes).len() <= room
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
        Err(full)
    }

    /// The error that no place is left, with the processes that have them.
    fn refused(&self, reason: impl Display) -> OpenError {
        let Some(OpenPlaces { places: allowed, own }) = self.limit() else {
            return OpenError::port(self.service, reason);
        };
        let mut holders = self.others(own, &(self.nodes)());
        holders.sort();
        holders.dedup();
        OpenError::Places { service: self.service.name(), allowed, holders: holders.join(", ") }
    }

    /// The places that this member is bound to. `None`: all.
    fn limit(&self) -> Option<OpenPlaces> {
        self.open.filter(|open| !open.own.contains(&self.bus.node.name().as_str()))
    }

    /// The holders of ports on `nodes`, but for those of `own`, each with name and pid.
    fn others(&self, own: &[&str], nodes: &[UniqueNodeId]) -> Vec<String> {
        let mut known = Vec::new();
        let _section = ForkSection::enter();
        // What cannot be listed is nobody's own.
        let _ = Node::<Ipc>::list(&self.bus.member.config, |node| {
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
            (!own.contains(&name)).then(|| format!("{name} (pid {pid})"))
        };
        nodes.iter().filter_map(named).collect()
    }
}
