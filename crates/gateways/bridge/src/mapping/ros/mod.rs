//! ROS 2 messages: what they say of robots, and what robots' values are as messages.

pub(crate) mod discovery;
pub(crate) mod incoming;
pub(crate) mod names;
pub(crate) mod outgoing;
