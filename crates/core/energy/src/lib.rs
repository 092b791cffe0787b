//! The energy of a robot over a sequence of commands, from one second to five minutes.
//!
//! Pure: no clock, file, thread or shared memory; nothing allocates except reading and writing a
//! model's text. The same inputs give the same bits on every machine.
//!
//! - [`EnergyState`] is what is known of a robot: a few means of its power, advanced by
//!   [`EnergyState::observe`] with every sample.
//! - [`EnergyModel`] is what is known of a platform: the power of a command, how far to trust which
//!   mean at which horizon, and how large the errors were on held-out recordings.
//! - [`Calibration`] is what all robots of a platform have shown of the model's errors since.
//! - [`EnergyModel::forecast`] gives the energy of [`Commands`] as an [`EnergyForecast`].
//! - [`EnergyModel::outlook`] gives the energy of a robot that goes on as it does.
//!
//! **The forecast.** A robot's *level* is its power over the last seconds relative to what the
//! command model says of the commands in that time. The energy of the plan is what the command
//! model says of it, scaled by the level. Levels over several time constants, shrunk to the
//! platform's while little was read, are weighted; weights depend on the horizon.
#![forbid(unsafe_code)]

mod calibration;
mod command;
mod forecast;
mod lasting;
mod levels;
mod model;
mod outlook;
mod quantiles;
mod state;

pub use calibration::{
    CLASSES, Calibration, ERRORS, ErrorBounds, ErrorCounts, NewErrors, PARTS, PlatformErrors,
};
pub use command::{COMBINED_TERMS, CommandModel, TERMS};
pub use forecast::{CommandSum, Commands, EnergyForecast};
pub use lasting::{Lasting, LastingPower};
pub use levels::{LEVELS, LEVELS_S, SHADOWS, SHADOWS_S};
pub use model::{EnergyModel, EnergyModelError, HORIZONS_S};
pub use outlook::{EnergyOutlook, OutlookModel};
pub use quantiles::{KNOTS, QUANTILES};
pub use state::{Ahead, EnergySample, EnergyState, Learned, Metered};
