//! Nodes of dead processes.

use std::panic::{AssertUnwindSafe, catch_unwind};

use iceoryx2::config::Config;
use iceoryx2::identifiers::UniqueNodeId;
use iceoryx2::node::{
    DeadNodeView, Node, NodeCleanupFailure, NodeDetails, NodeState, NodeView as _,
};
use iceoryx2::prelude::CallbackProgression;

use super::report::SweepReport;
use crate::ipc::Ipc;
use crate::os::fork::ForkSection;

/// Makes iceoryx2 remove the nodes of dead processes. Takes 1 to 25 ms if there are any. Returns
/// whether there were any, removed or not.
pub(crate) fn remove_dead_nodes(config: &Config, report: &mut SweepReport) -> bool {
    // iceoryx2 notes for the whole process that it removes a node.
    let _section = ForkSection::enter();
    let mut are_any = false;
    let listed = Node::<Ipc>::list(config, |node| {
        if let NodeState::Dead(dead) = node {
            are_any = true;
            match remove(*dead.id(), config) {
                Removal::Done => report.dead_nodes += 1,
                Removal::Later => {}
                Removal::Failed(reason) => {
                    tracing::debug!(reason, "a dead node could not be removed");
                    report.failed_nodes += 1;
                }
            }
        }
        CallbackProgression::Continue
    });
    if let Err(reason) = listed {
        tracing::debug!(%reason, "nodes could not be listed");
    }
    are_any
}

/// Outcome of the removal of one dead node.
#[derive(Debug, PartialEq)]
enum Removal {
    Done,
    /// Another process or thread has removed it, or is removing a node at this moment. iceoryx2
    /// removes one node at a time in a process, of whatever domain.
    Later,
    Failed(String),
}

/// Removes a dead node, by the configuration of its domain: the one that the node's own details
/// name is written by whoever made the node, and where details are missing iceoryx2 would take its
/// global configuration, which belongs to the program around this library.
fn remove(node: UniqueNodeId, config: &Config) -> Removal {
    let details = NodeDetails::__internal_new(&None, config);
    // iceoryx2 panics if the node is alive after all (#1880, #1936). On Linux a node that starts is
    // not taken for a dead one: its state file is locked before its context has the permissions by
    // which others know it. Where programs abort instead of unwinding, nothing helps.
    let removed = catch_unwind(AssertUnwindSafe(|| {
        DeadNodeView::<Ipc>::__internal_try_remove_stale_resources(node, details)
    }));
    match removed {
        Ok(Ok(())) => Removal::Done,
        Ok(Err(
            NodeCleanupFailure::AnotherInstanceIsCleaningUpTheNode
            | NodeCleanupFailure::ResourcesAlreadyCleanedUp,
        )) => Removal::Later,
        Ok(Err(reason)) => Removal::Failed(reason.to_string()),
        Err(_) => Removal::Failed("iceoryx2 panicked".to_owned()),
    }
}

pub(crate) fn is_any_node_alive(config: &Config) -> bool {
    let _section = ForkSection::enter();
    let mut alive = false;
    let listed = Node::<Ipc>::list(config, |node| {
        alive |= matches!(node, NodeState::Alive(_));
        CallbackProgression::Continue
    });
    alive || listed.is_err()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use iceoryx2::node::NodeBuilder;
    use iceoryx2::prelude::SignalHandlingMode;

    use super::*;
    use crate::Domain;
    use crate::cleanup::objects::objects;
    use crate::iceoryx_config::config_for;

    #[test]
    fn a_node_that_is_alive_after_all_stays_and_the_cleaning_process_goes_on() {
        let root = std::env::temp_dir().join(format!("joulebus-alive-{}", std::process::id()));
        let domain = Domain::new("alive", &root, "jbalive_").unwrap();
        fs::create_dir_all(domain.directory()).unwrap();
        let config = config_for(&domain).unwrap();
        let node = NodeBuilder::new()
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Ipc>()
            .unwrap();
        let panicked = Removal::Failed("iceoryx2 panicked".to_owned());
        assert_eq!(remove(*node.id(), &config), panicked);
        assert!(is_any_node_alive(&config));
        let mut report = SweepReport::default();
        assert!(!remove_dead_nodes(&config, &mut report));
        drop(node);
        for object in objects(&domain).unwrap() {
            fs::remove_file(object.path).unwrap();
        }
        fs::remove_dir_all(&root).unwrap();
    }
}
