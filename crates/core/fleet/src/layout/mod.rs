//! Memory layout of robots: blocks of sixteen, slots, and the index by id, and instants.

pub(crate) mod index;
pub(crate) mod lanes;
pub(crate) mod shift;
pub(crate) mod slots;
