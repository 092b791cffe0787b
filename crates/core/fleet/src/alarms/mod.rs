//! Alarms.

pub(crate) mod conditions;
pub(crate) mod detector;
pub(crate) mod level;
