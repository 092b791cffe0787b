//! `joulebus bridge` as a separate program: a source of samples, and a planner that tells other systems.
#![forbid(unsafe_code)]

mod bridge;
mod config;
mod mapping;
mod mqtt;
mod publishing;
mod ros2;
mod shared;
mod telling;

use std::process::ExitCode;

fn main() -> ExitCode {
    joulebus_bus::trace_iceoryx2();
    joulebus_program::verb::main("bridge", bridge::run)
}
