//! SDK of a fleet controller or another source. It publishes commands and readings to the worker,
//! one frame per control tick for the whole fleet.
//!
//! ```no_run
//! use std::time::Duration;
//!
//! use joulebus_publisher::{Pace, Publisher, RobotState};
//!
//! fn main() -> anyhow::Result<()> {
//!     let mut publisher = Publisher::connect("configs/fleet.toml", "fleet-controller")?;
//!     let mut pace = Pace::every(Duration::from_nanos(33_333_333));
//!     for tick in 0.. {
//!         let slot = pace.wait();
//!         let robots = (0..20).map(|robot| {
//!             // The command just issued to each robot, and the reading of its power monitor.
//!             let (v_mps, omega_radps) = (0.2, 0.0);
//!             let power_w = 4.0 + 0.02 * ((tick + robot) % 7) as f32;
//!             RobotState::new(robot).command(v_mps, omega_radps).reading(power_w)
//!         });
//!         publisher.publish_intended(slot.intended_ns, robots)?;
//!     }
//!     Ok(())
//! }
//! ```
//!
//! **Three types to know.** A [`Publisher`] sends frames. A [`RobotState`] is one robot in a frame.
//! A [`Pace`] keeps the rate of the frames.
//!
//! **Units** are m/s, rad/s, W, V, A (positive while discharging) and ns. Times are of the host's
//! monotonic clock ([`clock::monotonic_ns`]). Leave unknown values out. Never give them as 0.
//!
//! **Guarantees.**
//!
//! - Samples are numbered and stamped here.
//! - A frame is written once, directly into shared memory. Publishing never blocks: when the worker
//!   is too slow, the oldest frame is overwritten, and the worker counts what it lost.
//! - A publisher may start before the worker, and outlive it. [`Sent::readers`] is 0 then, and
//!   nothing else changes.
//! - After each robot has been published once, [`Publisher::publish`] allocates nothing of its own.
//!   iceoryx2 allocates once per frame.
//!
//! **Refused values.** The worker refuses NaN as a known power, a speed beyond the platform's
//! limits, and a robot that the config does not name. The publisher sends them all the same, so
//! that the worker counts them by reason and reports them to operators. Other robots are not
//! affected. [`Sent::refused`] states that at once, by the worker's own rule.
//!
//! **Implausible values** are values that no limit refuses, such as a power of the wrong sign or in
//! mW. They raise the alarm `Implausible` of their robot: a thread of the publisher judges what is
//! published, some seconds later. A program that wants the remedies in words gives its states to a
//! [`Judgement`].
//!
//! **Errors** state the remedy: [`ConnectError`] at the start, [`PublishError`] for a frame. After
//! the latter the publisher remains usable. [`error`] has the errors that they contain.
//!
//! **Leaving.** Drop the publisher. A running worker still receives the frames sent before, unless
//! the source connected after the worker last woke up. A program that publishes for less than a few
//! milliseconds should stay a moment longer.
//!
//! **Threads and processes.** A [`Publisher`] belongs to the thread that connected it. A process
//! may have publishers of several fleets, and may use iceoryx2 for itself: its global configuration
//! and its logger are left alone.
//!
//! **In the book**: [Rust][1], [the age of a reading][2], [config: every key][3],
//! [whom joulebus trusts][4].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/tutorial/rust.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/explanation/freshness.md
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/reference/config.md
//! [4]: https://github.com/joulebus/joulebus/blob/main/docs/explanation/trust.md
#![forbid(unsafe_code)]

mod judgement;
mod pace;
mod publisher;
mod state;
mod watch;

pub use joulebus_bus::{SendError, WaitError, clock};
pub use joulebus_config::Config;
pub use joulebus_config::settings::RefusedSample;
pub use joulebus_connect::{ConnectError, error};
pub use joulebus_plausibility as plausibility;
pub use joulebus_wire as wire;
pub use judgement::{Implausible, Judgement};
pub use pace::{Grid, Pace, Slot};
pub use publisher::{PublishError, Publisher, Sent};
pub use state::{Charger, RobotState};
