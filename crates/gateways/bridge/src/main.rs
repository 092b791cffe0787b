//! The program of `joulebus bridge`: a source of samples for a fleet, and a planner that passes its
//! frames to other systems.
#![forbid(unsafe_code)]

mod arguments;
mod bridge;
mod config;
mod mapping;
mod mqtt;
mod outbound;
mod publishing;
mod ros2;
mod shared;
mod usual;

use std::process::ExitCode;

fn main() -> ExitCode {
    joulebus_bus::trace_iceoryx2();
    joulebus_program::verb::main("bridge", joulebus_bus::check_stack(), bridge::run)
}
