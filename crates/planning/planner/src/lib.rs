#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod client;
mod planner;

pub use client::{Answered, ClientError, PlanClient, QueryError};
#[doc(inline)]
pub use joulebus_config::Config;
#[doc(inline)]
pub use joulebus_connect::{ConnectError, error};
#[doc(inline)]
pub use joulebus_consumer::{ReadError, WorkerState};
#[doc(inline)]
pub use joulebus_models::ModelsError;
pub use joulebus_plan as plan;
pub use planner::{Planner, View, ViewError};
