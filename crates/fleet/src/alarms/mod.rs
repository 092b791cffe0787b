//! Which alarms a robot raises.

pub(crate) mod conditions;
pub(crate) mod detector;
