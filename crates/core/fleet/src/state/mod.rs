//! The state of all robots: in columns for the tick, and as a value.

pub(crate) mod columns;
pub(crate) mod shift;
pub(crate) mod snapshot;
