//! The program of `joulebus serve`: a fleet's page, API and metrics, and its alarms.
#![forbid(unsafe_code)]

mod arguments;
mod http;
mod serve;
mod webhook;

use std::process::ExitCode;

fn main() -> ExitCode {
    joulebus_bus::trace_iceoryx2();
    joulebus_program::verb::main("serve", joulebus_bus::check_stack(), serve::run)
}
