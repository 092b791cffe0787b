//! Energy: the ledger, and the energy left in the battery.

pub(crate) mod battery;
pub(crate) mod counting;
pub(crate) mod departed;
pub(crate) mod energy;
mod fusion;
pub(crate) mod gap;
mod lessons;
pub(crate) mod levels;
pub(crate) mod measured;
pub(crate) mod remaining;
