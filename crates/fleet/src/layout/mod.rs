//! Memory layout of robots: blocks of sixteen, slots, and the index by id.

pub(crate) mod index;
pub(crate) mod lanes;
pub(crate) mod slots;
