//! `joulebus serve` as a separate program: streams a fleet's messages to other programs.
#![forbid(unsafe_code)]

mod foxglove;
mod guard;

use std::process::ExitCode;

fn main() -> ExitCode {
    joulebus_program::verb::main("serve", foxglove::run)
}
