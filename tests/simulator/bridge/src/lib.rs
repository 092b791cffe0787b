//! The threads of `joulebus bridge` that open ports: its own sources, without connections.
#![allow(missing_docs)] // Used by tests alone.
#![forbid(unsafe_code)]
#![allow(dead_code, unused_imports, reason = "the connections use what these threads do not")]

#[path = "../../../../crates/gateways/bridge/src/mapping/mod.rs"]
mod mapping;
#[path = "../../../../crates/gateways/bridge/src/outbound.rs"]
mod outbound;
mod process;
#[path = "../../../../crates/gateways/bridge/src/publishing.rs"]
mod publishing;
#[path = "../../../../crates/gateways/bridge/src/shared.rs"]
mod shared;

pub use process::Bridge;
