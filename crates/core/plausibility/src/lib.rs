//! Judges whether what robots report is plausible: sign, unit, clock, hold, range, saturation and
//! constancy.
//!
//! Pure: observations come in one by one, with their times, and findings come out. Memory is
//! bounded whatever the length. Nothing is altered. The caller decides what follows a finding: a
//! verb stops on an error, a bridge reports it.
//!
//! ```
//! use joulebus_plausibility::{Judge, Kind, Known, Observation, Quantity, Source};
//!
//! let mut judge = Judge::new(Known::default().within(Quantity::Power, 0.0, 20.0));
//! for row in 0..200 {
//!     let time_s = 0.1 * f64::from(row);
//!     // A robot that reports its power in mW.
//!     let (power_w, voltage_v, current_a) = (4_000.0 + f64::from(row % 7), 8.0, 0.5);
//!     judge.take(&Observation { power_w, voltage_v, current_a, ..Observation::at(time_s) });
//! }
//! let findings = judge.findings();
//! assert_eq!(findings[0].kind, Kind::Unit);
//! assert_eq!(findings[0].quantity, Some(Quantity::Power));
//! println!("{}: {}", findings[0].found, findings[0].remedy(Source::Program, None));
//! ```
//!
//! **Three types to know.** A [`Judge`] takes the observations of one robot. An [`Observation`] is
//! what was seen of it at one time. A [`Finding`] states what was found, what is allowed and what
//! to do, in the words of the [`Source`].
//!
//! [`CurrentMonitor`], [`ChargerWatch`] and [`is_charge`] decide which readings of a battery are a
//! robot's consumption.
//!
//! Two more judge alone: [`Stamps`] compares the stamps of messages with the times of their
//! recording, and [`resolution`](resolution()) finds the step of a power monitor.
//!
//! **Units** are SI. Unknown values are NaN.
//!
//! **Errors.** There are none: each observation is taken. A finding has a [`Severity`].
//!
//! **Thresholds** were chosen on simulated recordings: three robots of 4 to 300 W at rest, 1 to 100
//! Hz, 150 to 2,000 rows, up to 30 % of them missing, 0 to 90 % idle (`tests/all/grid.rs`). The
//! real recordings took no part in that choice:
//!
//! | planted | simulated | real: Robotino, Husky, rover |
//! |---|---|---|
//! | nothing, regeneration, charger, rest | 0 findings in 3,024 | 0 in 780 |
//! | the other sign | 396 of 396 | 780 of 780 |
//! | the other sign, without a battery's voltage | 373 of 396, the others are warnings | |
//! | the other sign, braking a twentieth of the time | 364 of 396 | |
//! | a factor of a thousand | 432 of 432 each | 720 of 780: the rover has power alone |
//! | a percentage for a share | 432 of 432 | |
//!
//! **In the book**: [plausibility of recordings][1], [from messages to samples][2].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/reference/plausibility.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/explanation/bridges.md
#![forbid(unsafe_code)]

mod battery;
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

pub use battery::{
    ChargerWatch, CurrentMonitor, SupplyStatus, charging_of_text, is_charge, on_charger,
};
pub use clock::{StampState, Stamps};
pub use finding::{Finding, Kind, Severity, Source};
pub use hold::{COMMAND_HOLDS_S, Expired};
pub use judge::{Judge, Known, TimeUnit};
pub use observation::Observation;
pub use quantity::{Quantity, UNMEASURED_A};
pub use resolution::resolution;
