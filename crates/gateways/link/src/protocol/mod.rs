//! The protocol between two links, and that of ROS 2's rmw_zenoh: pure, without clock, network,
//! thread and shared memory.

pub(crate) mod carried;
#[cfg(test)]
pub(crate) mod hostile;
pub(crate) mod lease;
pub(crate) mod message;
pub(crate) mod offset;
pub(crate) mod receiver;
pub(crate) mod rmw;
pub(crate) mod selection;
pub(crate) mod shift;
pub(crate) mod stream;
#[cfg(test)]
mod weather;
