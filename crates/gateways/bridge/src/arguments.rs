//! Command-line options of `joulebus bridge`.

use std::path::PathBuf;

use joulebus_program::config_file::ConfigFile;

/// Bring robots that speak MQTT or ROS 2 into a fleet, and tell others its forecasts, budgets and
/// alarms
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus bridge configs/bridges/json.toml             power and commands as JSON, forecasts and budgets out\n  \
    joulebus bridge configs/bridges/vda5050.toml          vehicles' states by VDA 5050\n  \
    joulebus bridge configs/bridges/robotarium.toml       asks the Robotarium's robots; sends them nothing else\n  \
    joulebus bridge configs/bridges/ros2.toml             battery states and commands of ROS 2, diagnostics out\n  \
    joulebus bridge my-bridge.toml --check                only checks the file\n\n\
    FILE says which robots are meant by which names, where values stand in messages, with units and signs: \
    docs/bridges.md. A bridge is a source and a planner like any other; several may run beside each other, each \
    with a name of its own. It connects again by itself. What it cannot map is counted, named once on stderr, and \
    listed at the end.\n\n\
    Exit codes: 0 ended by a signal; 1 the fleet or the ROS domain cannot be joined, or the broker refuses the login at the start; \
    2 a wrong option, config or FILE; 3 messages could not be mapped, or what was to be told was lost.")]
pub(crate) struct BridgeArguments {
    /// What is bridged
    #[arg(value_name = "FILE")]
    pub(crate) file: PathBuf,
    /// Only check FILE, and say what it does
    #[arg(long)]
    pub(crate) check: bool,
    /// The fleet's config.
    #[command(flatten)]
    pub(crate) config: ConfigFile,
}
