//! Judges whether what robots report is plausible: sign, unit, clock, hold, range, saturation,
//! constancy.
//!
//! Pure: observations come in one by one, with their times, and findings come out. Memory is bounded
//! whatever the length. Nothing is altered, and nobody decides here what follows: a verb stops on an
//! error, a bridge raises an alarm.
#![forbid(unsafe_code)]

mod clock;
mod column;
mod finding;
mod hold;
mod judge;
mod quantity;
mod resolution;
mod saturation;
mod sign;
mod sizes;
mod unit;

pub use clock::{StampState, Stamps};
pub use finding::{Finding, Kind, Severity, Source};
pub use judge::{Judge, Known, Observation};
pub use quantity::Quantity;
pub use resolution::resolution;
