//! Removing what dead processes leave behind.

pub(crate) mod dead_nodes;
pub(crate) mod incomplete;
pub(crate) mod keeper;
pub(crate) mod objects;
pub(crate) mod report;
pub(crate) mod sweep;
