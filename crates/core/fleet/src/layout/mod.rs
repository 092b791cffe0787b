//! Memory layout of robots: blocks of sixteen, slots, and the index by id, instants, and
//! the versions of its encoding.

pub(crate) mod index;
pub(crate) mod lanes;
pub(crate) mod shift;
pub(crate) mod slots;
pub(crate) mod versions;
