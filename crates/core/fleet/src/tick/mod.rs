//! The tick: features, network, scores and alarms, and output.

pub(crate) mod batch;
pub(crate) mod context;
pub(crate) mod features;
pub(crate) mod infer;
pub(crate) mod outputs;
pub(crate) mod platform_context;
pub(crate) mod schedule;
pub(crate) mod score;
pub(crate) mod shard;
pub(crate) mod write;
