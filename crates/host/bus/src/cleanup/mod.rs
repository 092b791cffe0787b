//! Removing stale files of dead processes.

pub(crate) mod claim;
pub(crate) mod dead_nodes;
pub(crate) mod incomplete;
pub(crate) mod objects;
pub(crate) mod removed;
pub(crate) mod report;
pub(crate) mod sweep;
pub(crate) mod thread;
