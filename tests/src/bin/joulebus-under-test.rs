//! The `joulebus` program, built together with the tests that start it.
#![forbid(unsafe_code)]

use std::process::ExitCode;

fn main() -> ExitCode {
    joulebus_cli::main()
}
