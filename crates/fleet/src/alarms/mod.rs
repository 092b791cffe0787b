//! Which alarms a robot raises.

pub(crate) mod detector;
