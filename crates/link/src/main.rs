//! `joulebus link` as a separate program: a source and a planner like any other, that speak to their like on other hosts.
#![forbid(unsafe_code)]

mod config;
mod follow;
mod forward;
mod gathered;
mod giving;
mod intake;
mod link;
mod network;
mod outlets;
mod outputs;
mod protocol;
mod refusals;
mod taking;

use std::process::ExitCode;

fn main() -> ExitCode {
    joulebus_program::verb::main("link", link::run)
}
