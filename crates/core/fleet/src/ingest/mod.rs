//! Ingest: the checks of samples, and the state kept of them.

pub(crate) mod admission;
pub(crate) mod check;
pub(crate) mod codes;
pub(crate) mod frame;
pub(crate) mod last_sample;
pub(crate) mod pending;
pub(crate) mod refused;
pub(crate) mod sources;
