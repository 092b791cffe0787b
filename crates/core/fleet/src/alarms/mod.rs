//! Alarms.

pub(crate) mod conditions;
pub(crate) mod detector;
