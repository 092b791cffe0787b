//! Liveness of processes: locks and descriptors that the kernel releases when a process ends.

pub(crate) mod guarded;
pub(crate) mod lock_watch;
pub(crate) mod members_lock;
pub(crate) mod peer_watch;
pub(crate) mod presence;
pub(crate) mod worker_lock;
pub(crate) mod worker_ports;
