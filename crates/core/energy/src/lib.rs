//! The energy of a robot over a sequence of commands, from one second to five minutes.
//!
//! Pure: no clock, file, thread or shared memory. The same inputs give the same bits on every
//! machine. Nothing allocates but reading and writing a model's text.
//!
//! ```
//! use joulebus_energy::{Commands, EnergyModel, EnergySample, EnergyState};
//!
//! let model = EnergyModel::untrained(4.0);
//! let mut state = EnergyState::new(0);
//! for _ in 0..600 {
//!     // A robot at rest that draws 3 W, read thirty times a second for 20 s.
//!     let (power_w, elapsed_s) = (3.0, 1.0 / 30.0);
//!     state.observe(&model, &EnergySample { power_w, elapsed_s, v_mps: 0.0, omega_radps: 0.0 });
//! }
//! let plan = Commands { period_s: 1.0, v_mps: &[0.1; 10], omega_radps: &[0.0; 10] };
//! let forecast = model.forecast(&state, plan);
//! assert_eq!(forecast.duration_s, 10.0);
//! assert!((29.9..30.1).contains(&forecast.energy_j));
//! // A model without training knows no errors, and so no interval.
//! assert_eq!(forecast.quantile_j(0.95), None);
//! assert_eq!(EnergyModel::from_text(&model.to_text())?, model);
//! # Ok::<(), joulebus_energy::EnergyModelError>(())
//! ```
//!
//! **Three types to know.** An [`EnergyState`] is what is known of a robot: a few means of its
//! power, which each sample advances. An [`EnergyModel`] is what is known of a platform. An
//! [`EnergyForecast`] is the energy of [`Commands`], with the distribution of its error.
//!
//! **The forecast.** A robot's *level* is its recent power, relative to the power that the command
//! model gives for the same time. The energy of a plan is the command model's energy, scaled by the
//! level. Levels over several time constants are weighted by the horizon. A level that rests on few
//! readings is drawn to that of the platform.
//!
//! **Beside it.** [`EnergyModel::outlook`] prepares the energy of robots that go on as they do. A
//! [`Calibration`] is what the robots of a platform have shown of the model's errors.
//! [`PlatformErrors`] adapts the intervals to them, and has what the platform [remembers](Memory). [`EnergyLeft`] is what a battery has, now or after
//! a plan.
//!
//! **Units** are W, J, s, m/s and rad/s. Unknown values are NaN in samples, and `None` in results.
//!
//! **Errors** name the value of the model, what was found and what is allowed
//! ([`EnergyModelError`]).
//!
//! **In the book**: [energy over a horizon][1], [outlooks][2], [a level times a command model][3].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/explanation/energy.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/explanation/outlooks.md
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/plans-energy.md#the-energy-of-a-plan-is-a-level-times-a-command-model
#![forbid(unsafe_code)]

mod calibration;
mod command;
mod forecast;
mod lasting;
mod left;
mod levels;
mod memory;
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
pub use left::EnergyLeft;
pub use levels::{LEVELS, LEVELS_S, SHADOWS, SHADOWS_S};
pub use memory::{GROUPS, Memory, SHOWN, Shown, group_of, shown_start};
pub use model::{EnergyModel, EnergyModelError, HORIZONS_S};
pub use outlook::{EnergyOutlook, OutlookModel};
pub use quantiles::{KNOTS, QUANTILES};
pub use state::{Ahead, EnergySample, EnergyState, Learned, Made, Metered};
