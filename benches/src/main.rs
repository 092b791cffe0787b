//! `joulebus bench` as a separate program.
#![forbid(unsafe_code)]

use std::process::ExitCode;

fn main() -> ExitCode {
    joulebus_bench::main()
}
