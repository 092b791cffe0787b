//! What a planner adds to know what its robots will draw: the newest forecast of each, read where
//! the worker has written it.
//!
//! ```no_run
//! use joulebus_consumer::{Event, Planner};
//! # use std::time::Duration;
//! # fn plan(_: f32, _: (f32, f32)) {}
//! # fn stop_relying_on_forecasts() {}
//! let mut planner = Planner::connect("configs/fleet.toml")?;
//! loop {
//!     match planner.wait_next(Duration::from_secs(1))? {
//!         Event::Frame(frame) => {
//!             let forecast = frame.robot(7);
//!             if let Some((power_w, interval_w)) =
//!                 forecast.and_then(|forecast| forecast.power_w().zip(forecast.interval_w()))
//!             {
//!                 plan(power_w, interval_w);
//!             }
//!         }
//!         Event::Gone(_) | Event::Stale { .. } => stop_relying_on_forecasts(),
//!         Event::Interrupted | Event::TimedOut => {}
//!     }
//! }
//! # #[allow(unreachable_code)]
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! **Units**: W, J, s, ns. Times are of the host's monotonic clock ([`clock::monotonic_ns`]). What
//! is not known is `None` from the accessors ([`wire::Forecast::power_w`]), NaN in the fields;
//! [`wire::Forecast::quality`] says how far to trust the rest.
//!
//! **The worker** may start later, end, die and come back: a planner just goes on. Its death is an
//! event at once, because the kernel tells of it, not a time-out ([`Event::Gone`]). A worker that
//! lives but falls silent is noticed when its newest frame is older than two tick periods
//! ([`Event::Stale`]). After either, the next frame says that all is well again.
//!
//! **Gaps.** A planner always gets the newest frame. Those that it was too slow for are counted
//! ([`Arrival::ticks_missed`], [`Counts`]). A slow or stopped planner costs the worker nothing.
//!
//! **Lifetimes.** A frame lies in shared memory and is borrowed from the [`Planner`], or from the
//! [`DiagnosticFeed`] or [`BudgetFeed`], each of which holds exactly one: it stays as it is until
//! the next call that takes a newer one, for however long that is. To keep more, copy: rows are
//! `Copy`. [`Frame::robot`] takes constant time as long as no robots come or go. Feeds are separate
//! so that a frame of each may be looked at together.
//!
//! **Errors** say what to do: [`ConnectError`] at the start, [`ReadError`] later; after the latter
//! the planner may be used again.
//!
//! **Leaving** is dropping. Everything here belongs to the thread that connected it, and all
//! planners of one process to one fleet.
#![forbid(unsafe_code)]

mod feed;
mod frame;
mod index;
mod planner;
mod tracker;

pub use feed::{BudgetFeed, DiagnosticFeed};
pub use frame::{Budgets, Diagnostics, Forecasts, Frame};
pub use joulebus_bus::{OpenError, clock};
pub use joulebus_config::Config;
pub use joulebus_wire as wire;
pub use planner::{ConnectError, Event, Planner, ReadError};
pub use tracker::{Arrival, Counts, End, WorkerState};
