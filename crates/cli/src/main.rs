//! The `joulebus` program.
#![forbid(unsafe_code)]

use std::process::ExitCode;

fn main() -> ExitCode {
    joulebus_bus::trace_iceoryx2();
    joulebus_cli::main()
}
