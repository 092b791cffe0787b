//! `joulebus serve`.

use std::net::IpAddr;

use crate::config_file::ConfigFile;

/// Stream what goes through a fleet's shared memory to Foxglove, live
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus serve --foxglove\n  \
    joulebus serve --foxglove --per-robot --port 9000\n\n\
    In Foxglove: Open connection, Foxglove WebSocket, ws://127.0.0.1:8765; then import the layout \
    configs/foxglove/joulebus.json. The topics and schemas are those of a capture. Only this host \
    can connect unless --host names another address: there is no password, and whoever can connect \
    sees everything.")]
pub struct ServeArguments {
    /// Serve the Foxglove WebSocket protocol
    #[arg(long, required = true)]
    pub foxglove: bool,
    /// Address to listen at; 0.0.0.0 lets everybody on the network in
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1")]
    pub host: IpAddr,
    /// Port to listen at; 0: any that is free
    #[arg(long, default_value_t = 8765)]
    pub port: u16,
    /// A channel for each robot's sample, forecast, diagnostics and budget as well
    #[arg(long)]
    pub per_robot: bool,
    /// The fleet's config.
    #[command(flatten)]
    pub config: ConfigFile,
}
