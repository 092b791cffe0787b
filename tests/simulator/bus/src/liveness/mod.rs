//! Liveness of processes.

pub(crate) mod peer_watch;
pub(crate) mod worker_lock;
#[path = "../../../../../crates/host/bus/src/liveness/worker_ports.rs"]
pub(crate) mod worker_ports;
