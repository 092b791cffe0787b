//! What a sample must pass to be taken, and what is kept of it.

pub(crate) mod check;
pub(crate) mod codes;
pub(crate) mod refused;
pub(crate) mod robot;
pub(crate) mod sources;
