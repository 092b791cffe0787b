//! `joulebus bench`, a program of its own.
#![forbid(unsafe_code)]

use std::process::ExitCode;

fn main() -> ExitCode {
    joulebus_bench::main()
}
