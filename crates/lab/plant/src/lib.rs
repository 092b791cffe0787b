//! Simulated robots: their loads, battery and monitor, the paper's protocols, and a live fleet.
//!
//! `joulebus-sim` records them as trials. This crate needs neither files nor linear algebra, so
//! that the demo compiles little.
//!
//! ```
//! use joulebus_plant::{Fault, Plant};
//!
//! let drag = Fault::ExtraLoad { power_w: 2.0 };
//! let mut faulty = Plant::new(7, 3).with_fault(1, drag, 0.0)?;
//! let mut sound = Plant::new(7, 3);
//! for _ in 0..30 {
//!     faulty.step(1.0 / 30.0);
//!     sound.step(1.0 / 30.0);
//! }
//! let (faulty, sound) = (faulty.step(1.0 / 30.0), sound.step(1.0 / 30.0));
//! assert_eq!(faulty[0], sound[0]);
//! assert!(faulty[1].power_w > sound[1].power_w + 1.0);
//! # Ok::<(), joulebus_plant::PlantError>(())
//! ```
//!
//! **Three types to know.** A [`Plant`] is a fleet of simulated robots, each of which drives the
//! paper's protocols. A [`SimReading`] is what a controller knows of a robot after a step. A
//! [`Fault`] is what can be wrong with one. A program that drives robots by itself uses
//! [`driven::Driven`].
//!
//! **The same bits.** A seed determines every reading, on every machine.
//!
//! **Units** are W, V, A, s, ns, m, m/s and rad/s.
//!
//! **Errors.** Only a fault of a robot that does not exist is refused ([`PlantError`]), and the
//! number of no trial ([`protocol::UnknownTrial`]). A step of no positive length has no effect.
//!
//! **In the book**: [the simulated robots][1], [the simulated robots beside the paper][2], [the
//! demo][3].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/explanation/plant.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/measured/plant.md
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/tutorial/demo.md
#![forbid(unsafe_code)]

pub mod arena;
pub mod body;
pub mod driven;
mod fault;
mod loads;
pub mod monitor;
pub mod parts;
mod plant;
pub mod protocol;

pub use fault::Fault;
pub use plant::{Plant, PlantError, SimReading};
