//! The `joulebus` program.
#![forbid(unsafe_code)]

use std::process::ExitCode;

fn main() -> ExitCode {
    joulebus_cli::main()
}
