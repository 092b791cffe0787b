//! `joulebus export` as a separate program: recordings and captures as a folder of Parquet files.
#![forbid(unsafe_code)]

mod archive;
mod export;
mod partition;

use std::process::ExitCode;

fn main() -> ExitCode {
    joulebus_program::verb::main("export", export::run)
}
