//! What a fleet controller adds to be heard: its commands and readings go to the worker, one frame
//! per control tick for the whole fleet.
//!
//! ```no_run
//! use joulebus_publisher::{Publisher, RobotState};
//! # struct Robot { id: u32, v_mps: f32, omega_radps: f32, power_w: f32 }
//! # let robots: Vec<Robot> = Vec::new();
//! let mut publisher = Publisher::connect("configs/fleet.toml", "fleet-controller")?;
//! // 30 times a second, when the commands have been issued:
//! publisher.publish(robots.iter().map(|robot| {
//!     RobotState::new(robot.id).command(robot.v_mps, robot.omega_radps).reading(robot.power_w)
//! }))?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! **Units**: m/s, rad/s, W, V, A (positive while discharging), ns. Times are of the host's
//! monotonic clock ([`clock::monotonic_ns`]). What is not known is left out, never given as 0.
//!
//! **What is promised.** Samples are numbered and stamped here. A frame is written once, straight
//! into shared memory; when the worker is too slow the oldest frame is overwritten, so publishing
//! never waits for anybody, and the worker counts what it lost. A publisher may start before the
//! worker, and outlive it: [`Sent::readers`] is 0 then, and nothing else changes. After each robot
//! has been published once, [`Publisher::publish`] allocates nothing of its own; iceoryx2
//! allocates once a frame.
//!
//! **What is not checked here.** Values go out as they are: NaN given as a known power, a speed
//! beyond the platform's limits or a robot that the config does not name is refused by the worker,
//! counted by its reason and shown to operators, without harm to other robots.
//!
//! **Errors** say what to do: [`ConnectError`] at the start, [`PublishError`] for a frame; after
//! the latter the publisher may be used again.
//!
//! **Leaving** is dropping. A running worker still gets the frames that were sent before, unless
//! the source had come only after the worker last woke up: a program that sends for less than a
//! few milliseconds stays a moment longer. A [`Publisher`] belongs to the thread that connected it, and all
//! publishers of one process to one fleet.
#![forbid(unsafe_code)]

mod pace;
mod publisher;
mod state;

pub use joulebus_bus::clock;
pub use joulebus_config::Config;
pub use joulebus_wire as wire;
pub use pace::{Grid, Pace, Slot};
pub use publisher::{ConnectError, PublishError, Publisher, Sent};
pub use state::RobotState;
