//! What a planner adds to know what its robots will draw: the newest forecast of each, read where
//! the worker has written it.
//!
//! ```no_run
//! use std::time::Duration;
//!
//! use joulebus_consumer::{Event, Planner};
//!
//! fn main() -> Result<(), Box<dyn std::error::Error>> {
//!     let mut planner = Planner::connect("configs/fleet.toml")?;
//!     loop {
//!         match planner.wait_next(Duration::from_secs(1))? {
//!             Event::Frame(frame) => {
//!                 for robot in &frame {
//!                     if let Some((lo_w, hi_w)) = robot.interval_w() {
//!                         println!("robot {} will draw {lo_w:.2} to {hi_w:.2} W", robot.robot);
//!                     }
//!                 }
//!             }
//!             Event::Gone(_) | Event::Stale { .. } => println!("do not rely on forecasts"),
//!             Event::Interrupted => return Ok(()),
//!             _ => {}
//!         }
//!     }
//! }
//! ```
//!
//! **Units**: W, J, s, ns. Times are of the host's monotonic clock ([`clock::monotonic_ns`]). What
//! is not known is `None` from the accessors ([`wire::Forecast::power_w`]), NaN in the fields;
//! [`wire::Forecast::quality`] says how far to trust the rest.
//!
//! **The worker** may start later, end, die and come back: a planner just continues. Its death is an
//! event at once, because the kernel tells of it, not a time-out ([`Event::Gone`]). A worker that
//! lives but falls silent is noticed when its newest frame is older than two tick periods
//! ([`Event::Stale`]). After either, the next frame says that all is well again.
//!
//! **Gaps.** A planner always gets the newest frame. Those that it was too slow for are counted
//! ([`Forecasts::arrival`], [`Counts`]). A slow or stopped planner costs the worker nothing.
//!
//! **Lifetimes.** A frame lies in shared memory and is borrowed from the [`Planner`], or from the
//! [`DiagnosticFeed`] or [`BudgetFeed`], each of which holds exactly one: it stays as it is until
//! the next call that takes a newer one, for however long that is. To keep more, copy: rows are
//! `Copy`. [`Frame::robot`] takes constant time as long as no robots come or go. Feeds are separate
//! so that a frame of each may be looked at together.
//!
//! **Errors** say what to do: [`ConnectError`] at the start, [`OpenError`] for a feed, [`ReadError`]
//! later; after the latter the planner may be used again. [`error`] has all that they are made of.
//!
//! **Leaving** is dropping. Everything here belongs to the thread that connected it, and all
//! planners of one process to one fleet.
#![forbid(unsafe_code)]

mod feed;
mod frame;
mod index;
mod newest;
mod planner;
mod tracker;

pub use feed::{BudgetFeed, DiagnosticFeed, Feed};
pub use frame::{Budgets, Diagnostics, Forecasts, Frame};
pub use joulebus_bus::{OpenError, clock};
pub use joulebus_config::{Config, ConnectError, error};
pub use joulebus_wire as wire;
pub use newest::ReadError;
pub use planner::{Event, Planner};
pub use tracker::{Arrival, Counts, End, WorkerState};
