//! Tests of bridges to MQTT, to ROS 2, and to both.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

mod both;
mod fleet;
mod mqtt;
mod ros2;
mod usual;
