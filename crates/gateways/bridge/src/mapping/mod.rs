//! The mapping between messages of other systems and the fleet's values. Pure: no clock, network,
//! file or thread. The time of a message is an argument.

pub(crate) mod account;
#[cfg(test)]
mod doors;
#[cfg(test)]
#[path = "../../tests/doors/mod.rs"]
mod every_door;
pub(crate) mod fields;
pub(crate) mod intake;
pub(crate) mod observation;
pub(crate) mod outgoing;
pub(crate) mod robots;
pub(crate) mod ros;
pub(crate) mod route;
pub(crate) mod simulated;
pub(crate) mod topic;
pub(crate) mod units;
