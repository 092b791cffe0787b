//! Energy: the ledger, and the energy left in the battery.

pub(crate) mod departed;
pub(crate) mod energy;
pub(crate) mod remaining;
