//! The program `joulebus-rosbag`: a bag of rosbag2 in an SQLite file as MCAP.
#![forbid(unsafe_code)]

mod bag;
mod convert;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser as _;
use joulebus_program::exit::{self, Outcome};
use joulebus_program::output::say;

/// Write the messages of a bag of rosbag2 (.db3) as MCAP, for `joulebus import`
#[derive(Debug, clap::Parser)]
#[command(
    name = "joulebus-rosbag",
    version,
    after_help = "Example:\n  \
    joulebus-rosbag bag_0.db3 -o bag_0.mcap\n\n\
    Messages that `joulebus import` does not read keep topic, type and time, and lose their contents. \
    Exit codes: 1 if nothing can be read; 3 if something was left out, each with a line on stderr."
)]
struct Args {
    /// The bag's SQLite file
    #[arg(value_name = "FILE")]
    bag: PathBuf,
    /// The MCAP file, which must not exist
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
}

fn main() -> ExitCode {
    match Args::try_parse() {
        Ok(args) => exit::code(run(&args)),
        Err(refused) => exit::refused(&refused),
    }
}

fn run(args: &Args) -> anyhow::Result<Outcome> {
    let left_out = convert::convert(&args.bag, &args.out)?;
    for (why, count) in &left_out {
        say(&format!("{count} messages left out: {why}"));
    }
    Ok(Outcome::unless_lost(!left_out.is_empty()))
}
