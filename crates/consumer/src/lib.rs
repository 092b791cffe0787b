//! SDK of a planner. It reads the newest forecast of each robot in place, in shared memory.
//!
//! ```no_run
//! use std::time::Duration;
//!
//! use joulebus_consumer::{Event, Subscriber};
//!
//! fn main() -> anyhow::Result<()> {
//!     let mut subscriber = Subscriber::connect("configs/fleet.toml")?;
//!     loop {
//!         match subscriber.wait_next(Duration::from_secs(1))? {
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
//! **Three types to know.** A [`Subscriber`] waits for frames. An [`Event`] is what it waited for:
//! a [`Frame`] of forecasts, or news of the worker.
//!
//! **Units** are W, J, s and ns. Times are of the host's monotonic clock ([`clock::monotonic_ns`]).
//! Unknown values are `None` from the accessors ([`wire::Forecast::expected_w`]), and NaN in the
//! fields. [`wire::Forecast::quality`] states how far to trust the rest.
//!
//! **The worker** may start later, end, die and be restarted: a subscriber continues. The kernel
//! reports the worker's exit at once, without a time-out ([`Event::Gone`]). A worker that is alive
//! but silent is detected when its newest frame is older than two tick periods ([`Event::Stale`]).
//! After either, the next frame ends the outage.
//!
//! **Alarms.** [`Subscriber::diagnostics`] has the raised ones. [`AlarmFeed`] has each raise and
//! each end.
//!
//! **Gaps.** A subscriber always gets the newest frame. Skipped frames are counted
//! ([`Frame::arrival`], [`Counts`]). A slow or stopped subscriber does not affect the worker.
//!
//! **Lifetimes.** A frame lies in shared memory. It is borrowed from the [`Subscriber`], or from
//! the [`Feed`] of another channel, each of which holds exactly one. It is unchanged until the next
//! call that takes a newer one. Copy what you need longer: rows are `Copy`. Or keep
//! up to two frames of forecasts where they lie ([`Subscriber::take_current`]). [`Frame::robot`]
//! takes constant time while no robots join or leave. Feeds are separate, so that a frame of each
//! may be borrowed at the same time.
//!
//! **Errors** state the remedy: [`ConnectError`] at the start and for a feed, [`ReadError`] later.
//! After the latter the subscriber remains usable. [`error`] has the errors that they contain.
//!
//! **Event loops** wait for [`Subscriber::readiness`].
//!
//! **Leaving.** Drop the subscriber.
//!
//! **Threads and processes.** Everything here belongs to the thread that connected it. A process
//! may have subscribers of several fleets, and may use iceoryx2 for itself: its global
//! configuration and its logger are left alone.
//!
//! **In the book**: [Rust][1], [alarms][2], [budgets][3], [outlooks][4], [layout of
//! shared memory][5].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/tutorial/rust.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/reference/alarms.md
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/explanation/budgets.md
//! [4]: https://github.com/joulebus/joulebus/blob/main/docs/explanation/outlooks.md
//! [5]: https://github.com/joulebus/joulebus/blob/main/crates/languages/c/include/joulebus.h
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
pub use joulebus_bus::{Readiness, clock};
pub use joulebus_config::Config;
pub use joulebus_connect::{ConnectError, error};
pub use joulebus_wire::{
    self as wire, Budgets, Diagnostics, Forecasts, Outlooks, PlanStates, Queries,
};
pub use newest::ReadError;
pub use source_alarms::{SourceAlarms, SourceChange};
pub use subscriber::{Event, Subscriber};
pub use tracker::{Arrival, Counts, End, WorkerState};
