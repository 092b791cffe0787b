//! The threads of `joulebus link`: its own sources, with a simulated network and a simulated store.
#![allow(missing_docs)] // Used by tests alone.
#![forbid(unsafe_code)]
#![allow(dead_code, unused_imports, reason = "the program uses what the threads do not")]

#[path = "../../../../crates/gateways/link/src/config/mod.rs"]
mod config;
#[path = "../../../../crates/gateways/link/src/egress.rs"]
mod egress;
mod etcd;
#[path = "../../../../crates/gateways/link/src/follow.rs"]
mod follow;
#[path = "../../../../crates/gateways/link/src/forward.rs"]
mod forward;
#[path = "../../../../crates/gateways/link/src/ingress.rs"]
mod ingress;
#[path = "../../../../crates/gateways/link/src/intake.rs"]
mod intake;
#[path = "../../../../crates/gateways/link/src/leadership.rs"]
mod leadership;
mod network;
#[path = "../../../../crates/gateways/link/src/output_port.rs"]
mod output_port;
#[path = "../../../../crates/gateways/link/src/outputs.rs"]
mod outputs;
mod process;
#[path = "../../../../crates/gateways/link/src/protocol/mod.rs"]
mod protocol;
#[path = "../../../../crates/gateways/link/src/refusals.rs"]
mod refusals;
#[path = "../../../../crates/gateways/link/src/report.rs"]
mod report;
#[path = "../../../../crates/gateways/link/src/shared.rs"]
mod shared;
#[path = "../../../../crates/gateways/link/src/standby.rs"]
mod standby;
#[path = "../../../../crates/gateways/link/src/protocol/lease/store.rs"]
mod store;
#[path = "../../../../crates/gateways/link/src/threads.rs"]
mod threads;
#[path = "../../../../crates/gateways/link/src/worker_ports.rs"]
mod worker_ports;

pub use etcd::{Access, SharedStore, reach};
pub use network::{Packet, deliver, lose, take_sent};
pub use process::{Link, LinkFile};
