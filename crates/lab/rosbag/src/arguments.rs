//! The program `joulebus-rosbag`, which `joulebus import` runs.

use std::path::PathBuf;

/// Write the messages of a bag of rosbag2 (.db3) as MCAP, for `joulebus import`
#[derive(Debug, clap::Parser)]
#[command(
    name = "joulebus-rosbag",
    version,
    after_help = "Example:\n  \
    joulebus-rosbag bag_0.db3 -o bag_0.mcap\n  \
    joulebus-rosbag bag_0.db3 -o - > bag_0.mcap\n\n\
    Messages that `joulebus import` does not read keep topic, type and time, and lose their \
    contents. Exit code 1: nothing can be read. Exit code 3: something was left out, each with a \
    line on stderr."
)]
pub(crate) struct RosbagArguments {
    /// The bag's SQLite file
    #[arg(value_name = "FILE")]
    pub(crate) bag: PathBuf,
    /// The MCAP file, which must not exist, or `-` for standard output, which must be an empty file
    #[arg(short, long, value_name = "FILE")]
    pub(crate) out: PathBuf,
    /// Exit when stdin closes: set by `joulebus import`, so that it is not outlived
    #[arg(long, hide = true)]
    pub(crate) exit_with_stdin: bool,
}
