//! What messages of other systems mean, and what the fleet's values are for them. Pure: no clock, network, file or
//! thread; the time that a message was heard comes in as an argument.

pub(crate) mod account;
pub(crate) mod fields;
pub(crate) mod intake;
pub(crate) mod observation;
pub(crate) mod outgoing;
pub(crate) mod robots;
pub(crate) mod ros;
pub(crate) mod route;
pub(crate) mod topic;
pub(crate) mod units;
pub(crate) mod vizier;
