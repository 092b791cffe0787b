//! Command-line options of `joulebus bridge`.

use std::path::PathBuf;

use joulebus_program::config_file::ConfigFile;

/// Bring robots that speak MQTT or ROS 2 into a fleet, and tell others its forecasts, budgets and
/// alarms
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus bridge configs/bridges/json.toml             power and commands as JSON, forecasts and budgets out\n  \
    joulebus bridge configs/bridges/vda5050.toml          vehicles' states by VDA 5050\n  \
    joulebus bridge configs/bridges/ros2.toml             battery states and commands of ROS 2, diagnostics out\n  \
    joulebus bridge my-bridge.toml --check                only checks the file\n  \
    joulebus bridge ros2 --robots 'robot{id}=0-9'         the usual topics, without a file\n  \
    joulebus bridge mqtt --robots 'robot{id}=0-9' --write my-bridge.toml   the same as a file, to be changed\n\n\
    FILE maps names to robots, and says where values stand in messages, with units and signs. \
    docs/reference/bridge-file.md has its keys. A bridge is a source and a planner like any \
    other. Several bridges may run beside each other, each with a name of its own. A bridge \
    connects again by itself. It counts what it cannot map, names it once on stderr, and lists it \
    at the end.\n\n\
    Exit code 0: ended by a signal. 1: the fleet or the ROS domain cannot be joined, or the \
    broker refuses the login at the start. 2: a wrong option, config or FILE. 3: messages could \
    not be mapped, or outputs were lost.")]
pub(crate) struct BridgeArguments {
    /// The bridge's file. `ros2` or `mqtt`: the usual topics of --robots, which are printed
    #[arg(value_name = "FILE")]
    pub(crate) file: PathBuf,
    /// With `ros2` or `mqtt`: names of robots and their ids, 'robot{id}=0-9' or lifter=12 (may be
    /// repeated)
    #[arg(long, value_name = "NAME=IDS")]
    pub(crate) robots: Vec<String>,
    /// With `mqtt`: the broker [default: localhost:1883]
    #[arg(long, value_name = "HOST:PORT")]
    pub(crate) broker: Option<String>,
    /// With `ros2` or `mqtt`: write the mapping as a new file, and end
    #[arg(long, value_name = "FILE")]
    pub(crate) write: Option<PathBuf>,
    /// Only check FILE, and say what it does
    #[arg(long)]
    pub(crate) check: bool,
    /// The fleet's config.
    #[command(flatten)]
    pub(crate) config: ConfigFile,
}
