//! Who is alive: locks and descriptors that the kernel gives back when their process ends.

pub(crate) mod members_lock;
pub(crate) mod peer_watch;
pub(crate) mod worker_lock;
