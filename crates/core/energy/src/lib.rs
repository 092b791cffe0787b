#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod calibration;
mod capacity;
mod command;
mod forecast;
mod lasting;
mod left;
mod levels;
mod memory;
mod model;
mod outlook;
mod quantiles;
mod ridge;
mod state;

pub use calibration::{
    CLASSES, Calibration, ERRORS, ErrorBounds, ErrorCounts, NewErrors, PARTS, PlatformErrors,
};
pub use capacity::{Capacity, MIN_DEPTH};
pub use command::{COMBINED_TERMS, CommandModel, TERMS};
pub use forecast::{CommandSum, Commands, EnergyForecast};
pub use lasting::{Lasting, LastingPower};
pub use left::EnergyLeft;
pub use levels::{LEVELS, LEVELS_S, SHADOWS, SHADOWS_S};
pub use memory::{GROUPS, Memory, SHOWN, Shown, group_of, shown_start};
pub use model::{EnergyModel, EnergyModelError, HORIZONS_S, Limit, RECORDED_S};
pub use outlook::{EnergyOutlook, OutlookModel};
pub use quantiles::{KNOTS, QUANTILES};
pub use ridge::{Outside, Quantity, RIDGE_TERMS, Ridge};
pub use state::{EnergySample, EnergyState, Learned, Metered};
