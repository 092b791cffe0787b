#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod alarms;
mod feed;
mod fleet_alarms;
mod frame;
mod index;
mod newest;
mod source_alarms;
mod subscriber;
mod tracker;

pub use alarms::{AlarmChange, AlarmFeed, AlarmHistory, Change};
pub use feed::Feed;
pub use fleet_alarms::{FleetAlarm, FleetAlarms};
pub use frame::{Frame, KeptForecasts};
#[doc(inline)]
pub use joulebus_bus::{Readiness, clock};
#[doc(inline)]
pub use joulebus_config::Config;
#[doc(inline)]
pub use joulebus_connect::{ConnectError, error};
pub use joulebus_wire as wire;
#[doc(inline)]
pub use joulebus_wire::{Budgets, Diagnostics, Forecasts, Outlooks, PlanStates, Queries};
pub use newest::ReadError;
pub use source_alarms::{SourceAlarms, SourceChange};
pub use subscriber::{Event, Subscriber};
pub use tracker::{Arrival, Counts, End, WorkerState};
