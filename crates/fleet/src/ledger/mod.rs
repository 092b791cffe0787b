//! Energy: what a robot has drawn, and what that leaves in its battery.

pub(crate) mod departed;
pub(crate) mod energy;
pub(crate) mod remaining;
