//! The mapping between ROS 2 messages and the values of robots.

pub(crate) mod discovery;
pub(crate) mod incoming;
pub(crate) mod names;
pub(crate) mod outgoing;
pub(crate) mod services;
