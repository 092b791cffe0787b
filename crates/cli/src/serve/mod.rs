//! `joulebus serve`: a fleet's messages to programs that are not part of it.

#[cfg(feature = "foxglove")]
mod foxglove;

use std::net::IpAddr;

use crate::config_file::ConfigFile;
use crate::exit::Outcome;
use crate::output::Output;

/// Stream what goes through a fleet's shared memory to Foxglove, live
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus serve --foxglove\n  \
    joulebus serve --foxglove --per-robot --port 9000\n\n\
    In Foxglove: Open connection, Foxglove WebSocket, ws://127.0.0.1:8765; then import the layout \
    configs/foxglove/joulebus.json. The topics and schemas are those of a capture. Only this host \
    can connect unless --host names another address: there is no password, and whoever can connect \
    sees everything.")]
pub(crate) struct Args {
    /// Serve the Foxglove WebSocket protocol
    #[arg(long, required = true)]
    foxglove: bool,
    /// Address to listen at; 0.0.0.0 lets everybody on the network in
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1")]
    host: IpAddr,
    /// Port to listen at; 0: any that is free
    #[arg(long, default_value_t = 8765)]
    port: u16,
    /// A channel for each robot's sample, forecast, diagnostics and budget as well
    #[arg(long)]
    per_robot: bool,
    #[command(flatten)]
    config: ConfigFile,
}

#[cfg(feature = "foxglove")]
pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    foxglove::run(args, output)
}

#[cfg(not(feature = "foxglove"))]
pub(crate) fn run(args: &Args, _: Output) -> anyhow::Result<Outcome> {
    let (address, port, per_robot) = (args.host, args.port, args.per_robot);
    tracing::debug!(foxglove = args.foxglove, %address, port, per_robot, config = args.config.name(), "not built in");
    let remedy = "build it with --features foxglove";
    Err(crate::exit::UsageError(format!(
        "this program was built without the Foxglove server; {remedy}"
    ))
    .into())
}

/// An address that others on the network can reach.
#[cfg(feature = "foxglove")]
fn warn_of(host: IpAddr) {
    if !host.is_loopback() {
        crate::output::say(&format!(
            "warning: {host} can be reached from other hosts, and there is no password"
        ));
    }
}
