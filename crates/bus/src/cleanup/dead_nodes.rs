//! Nodes of dead processes.

use iceoryx2::config::Config;
use iceoryx2::node::{Node, NodeState};
use iceoryx2::prelude::CallbackProgression;

use super::report::SweepReport;

/// Makes iceoryx2 remove the nodes of dead processes. Takes 1 to 25 ms if there are any.
pub(crate) fn remove_dead_nodes(config: &Config, report: &mut SweepReport) {
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

pub(crate) fn is_any_node_alive(config: &Config) -> bool {
    let mut alive = false;
    let listed = Node::<Ipc>::list(config, |node| {
        alive |= matches!(node, NodeState::Alive(_));
        CallbackProgression::Continue
    });
    alive || listed.is_err()
}
use crate::ipc::Ipc;
