//! The tick, pure: samples in, forecasts, diagnostics and budgets out.
//!
//! No clock, file, thread or shared memory: time is an argument, so that a live run, a replay and a
//! simulation execute the same code.
//!
//! ```
//! use joulebus_fleet::{OnlineForecasts, OnlineSettings};
//! use joulebus_predictor::{Model, Persistence, ResidualStats};
//! use joulebus_settings::IntervalSettings;
//!
//! let residual = ResidualStats { std_w: 0.1, q05_w: -0.2, q95_w: 0.2 };
//! let model = Model::Persistence(Persistence::new(residual)?);
//! let mut forecasts = OnlineForecasts::new(
//!     &model,
//!     OnlineSettings {
//!         interval: IntervalSettings { coverage: 0.9, rate: 0.2 },
//!         online: false,
//!         resolution_w: 0.01,
//!         power_min_w: 0.0,
//!         power_max_w: 20.0,
//!         longest_steps: 15,
//!     },
//! );
//! let robot = forecasts.add();
//! for _ in 0..100 {
//!     forecasts.read(robot, 4.0, 4.0, false);
//! }
//! let next = forecasts.forecast(Some(robot), 4.0);
//! assert_eq!(next.power_w, 4.0);
//! assert!(next.lo_w <= 4.0 && 4.0 <= next.hi_w);
//! # Ok::<(), joulebus_predictor::ModelError>(())
//! ```
//!
//! **Three types to know.** A [`Fleet`] [takes](Fleet::take) frames of samples, then
//! [ticks](Fleet::tick). Then it writes [forecasts](Fleet::forecast),
//! [diagnostics](Fleet::diagnostic) and [budgets](Fleet::budget), robot by robot, into the caller's
//! memory: the worker passes loaned shared memory. [`Schedule`] determines when a tick is due.
//! [`OnlineForecasts`] are the forecasts and intervals alone.
//!
//! After [`Fleet::new`] no fleet allocates.
//!
//! **Units** are those of `joulebus-wire`: SI, and ns for times.
//!
//! **Errors.** [`Fleet::new`] refuses settings that are inconsistent. A saved [`FleetState`] of
//! another version or of another fleet is refused ([`StateError`]). Samples never fail a tick: a
//! refused one is counted by reason and affects no other robot.
//!
//! **In the book**: [forecasts that learn online][1], [the same bits, live and offline][2], [tiles
//! of 512 robots][3].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/explanation/online-forecasts.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/the-tick.md#the-same-samples-give-the-same-bits-live-and-offline
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/the-tick.md#state-lies-in-blocks-of-sixteen-robots-and-ticks-process-tiles-of-512
#![forbid(unsafe_code)]

mod alarms;
mod estimate;
mod fleet;
mod ingest;
mod layout;
mod ledger;
mod state;
mod tick;

pub use estimate::online::Learned;
pub use estimate::scores::Scores;
pub use fleet::Fleet;
pub use fleet::online_forecasts::{IntervalForecast, OnlineForecasts, OnlineSettings};
pub use ingest::frame::{FrameIntake, TickIntake};
pub use joulebus_energy::ErrorCounts;
pub use ledger::battery::SavedBattery;
pub use ledger::energy::Ledger;
pub use state::snapshot::{FleetState, StateError};
pub use tick::batch::Batch;
pub use tick::schedule::{Next, Schedule};
pub use tick::shard::{Accounts, Outputs, Shard, Stage};
