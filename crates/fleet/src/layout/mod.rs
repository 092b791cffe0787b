//! How robots lie in memory: blocks of sixteen, slots, and where an id is found.

pub(crate) mod index;
pub(crate) mod lanes;
pub(crate) mod slots;
