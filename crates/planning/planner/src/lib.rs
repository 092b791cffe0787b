#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod client;
mod planner;

pub use client::{Answered, ClientError, PlanClient, QueryError};
pub use joulebus_config::Config;
pub use joulebus_connect::{ConnectError, error};
pub use joulebus_consumer::{ReadError, WorkerState};
pub use joulebus_models::ModelsError;
pub use planner::{Planner, View, ViewError};
