#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod judgement;
mod not_taken;
mod pace;
mod publisher;
mod state;
mod watch;

#[doc(inline)]
pub use joulebus_bus::{SendError, WaitError, clock};
#[doc(inline)]
pub use joulebus_config::Config;
#[doc(inline)]
pub use joulebus_config::settings::RefusedSample;
#[doc(inline)]
pub use joulebus_connect::refusals::Refused;
#[doc(inline)]
pub use joulebus_connect::{ConnectError, error};
pub use joulebus_plausibility as plausibility;
pub use joulebus_wire as wire;
pub use judgement::{Implausible, Judgement};
pub use not_taken::NotTaken;
pub use pace::{Grid, Pace, Slot};
pub use publisher::{PublishError, Publisher, Sent};
pub use state::{Charger, RobotState};

/// The columns of other languages. For the crate `joulebus-python`.
#[doc(hidden)]
pub mod columns {
    pub use crate::state::{COLUMNS, Column, SetColumn};
}
