//! Nodes of dead processes.

use iceoryx2::config::Config;
use iceoryx2::node::{Node, NodeState};
use iceoryx2::prelude::CallbackProgression;

use super::report::SweepReport;
use super::turn::Turn;
use crate::Domain;
use crate::ipc::Ipc;

/// Makes iceoryx2 remove the nodes of dead processes, one process of the domain at a time. Takes 1 to 25 ms if there
/// are any.
pub(crate) fn remove_dead_nodes(domain: &Domain, config: &Config, report: &mut SweepReport) {
    if !is_any_node_dead(config) {
        return;
    }
    let _turn = Turn::take(domain);
    let listed = Node::<Ipc>::list(config, |node| {
        if let NodeState::Dead(dead) = node {
            match dead.try_remove_stale_resources() {
                Ok(()) => report.dead_nodes += 1,
                Err(reason) => {
                    tracing::debug!(%reason, "a dead node could not be removed");
                    report.failed_nodes += 1;
                }
            }
        }
        CallbackProgression::Continue
    });
    if let Err(reason) = listed {
        tracing::debug!(%reason, "nodes could not be listed");
    }
}

fn is_any_node_dead(config: &Config) -> bool {
    let mut dead = false;
    let listed = Node::<Ipc>::list(config, |node| {
        dead = matches!(node, NodeState::Dead(_));
        if dead {
            CallbackProgression::Stop
        } else {
            CallbackProgression::Continue
        }
    });
    dead || listed.is_err()
}

pub(crate) fn is_any_node_alive(config: &Config) -> bool {
    let mut alive = false;
    let listed = Node::<Ipc>::list(config, |node| {
        alive |= matches!(node, NodeState::Alive(_));
        CallbackProgression::Continue
    });
    alive || listed.is_err()
}
