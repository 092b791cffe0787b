//! `joulebus serve` as a separate program: a fleet's page, API and metrics, and its messages in Foxglove.
#![forbid(unsafe_code)]

mod foxglove;
mod guard;
mod http;
mod serve;
mod webhook;

use std::process::ExitCode;

fn main() -> ExitCode {
    joulebus_bus::trace_iceoryx2();
    joulebus_program::verb::main("serve", serve::run)
}
