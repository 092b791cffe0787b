//! `joulebus bench` as a separate program.
#![forbid(unsafe_code)]

use std::process::ExitCode;

fn main() -> ExitCode {
    joulebus_bus::trace_iceoryx2();
    joulebus_bench::main()
}
