//! `joulebus serve`, a program of its own: a fleet's messages to programs that are not part of it.
#![forbid(unsafe_code)]

mod foxglove;
mod guard;

use std::process::ExitCode;

fn main() -> ExitCode {
    joulebus_program::verb::main("serve", foxglove::run)
}
