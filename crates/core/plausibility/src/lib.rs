//! Judges whether what robots report is plausible: sign, unit, clock, hold, range, saturation,
//! constancy.
//!
//! Pure: observations come in one by one, with their times, and findings come out. Memory is
//! bounded whatever the length. Nothing is altered, and nobody decides here what follows: a verb
//! stops on an error, a bridge tells it.
//!
//! Thresholds were chosen on simulated recordings: three robots of 4 to 300 W at rest, 1 to 100 Hz,
//! 150 to 2,000 rows, up to 30 % of them missing, 0 to 90 % idle (`tests/all/grid.rs`). The real
//! recordings took no part in that choice:
//!
//! | planted | simulated | real: Robotino, Husky, rover |
//! |---|---|---|
//! | nothing, regeneration, charger, rest | 0 findings in 3,024 | 0 in 780 |
//! | the other sign | 396 of 396 | 780 of 780 |
//! | the other sign, without a battery's voltage | 373 of 396, the others are warnings | |
//! | the other sign, braking a twentieth of the time | 364 of 396 | |
//! | a factor of a thousand | 432 of 432 each | 720 of 780: the rover has power alone |
//! | a percentage for a share | 432 of 432 | |
#![forbid(unsafe_code)]

mod clock;
mod column;
mod finding;
mod hold;
mod judge;
mod observation;
mod quantity;
mod resolution;
mod saturation;
mod sentinel;
mod sign;
mod sizes;
mod unit;

pub use clock::{StampState, Stamps};
pub use finding::{Finding, Kind, Severity, Source};
pub use hold::{COMMAND_HOLDS_S, Expired};
pub use judge::{Judge, Known, TimeUnit};
pub use observation::Observation;
pub use quantity::Quantity;
pub use resolution::resolution;
