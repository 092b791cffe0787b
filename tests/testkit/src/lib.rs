//! Shared by the tests of every crate: processes, ports, fleets, a counting allocator, recordings.
//!
//! Helpers that need a crate of joulebus are in `joulebus-testkit-fleets`.
#![allow(missing_docs)] // Used by tests alone.
#![deny(unsafe_code)]

mod certificates;
mod child;
mod confined;
mod contains;
pub mod counting;
mod end_signals;
mod fleet;
mod member;
mod on_drop;
mod pages;
mod ports;
pub mod recordings;
mod table;
#[cfg(feature = "trials")]
pub mod trials;

pub use certificates::certificates;
pub use child::{
    Child, Ended, PATIENCE, eventually, example_beside, joulebus_beside, lab_beside, left_behind,
    link_beside, remove, run,
};
pub use confined::{MemoryGroup, as_in_docker};
pub use contains::assert_contains;
pub use end_signals::{end_signals, ignores};
pub use fleet::{TestFleet, next_order, run_member};
pub use member::{Member, send_to_test};
pub use on_drop::OnDrop;
pub use pages::assert_page_contains;
pub use ports::free_port;
pub use table::cases;
