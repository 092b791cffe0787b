//! `joulebus serve`.

use std::net::IpAddr;

use crate::config_file::ConfigFile;

/// Stream the data in a fleet's shared memory to Foxglove, live
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus serve --foxglove\n  \
    joulebus serve --foxglove --per-robot --port 9000\n  \
    joulebus serve --foxglove --allow-origin https://lab.example\n\n\
    In Foxglove: Open connection, Foxglove WebSocket, ws://127.0.0.1:8765; then import the layout \
    configs/foxglove/joulebus.json. The topics and schemas are those of a capture. Only this host \
    can connect unless --host names another address: there is no password, and whoever can connect \
    sees everything. Web pages from elsewhere are refused; a handshake may take 5 s, and 64 \
    connections are taken at once.")]
pub struct ServeArguments {
    /// Serve the Foxglove WebSocket protocol
    #[arg(long, required = true)]
    pub foxglove: bool,
    /// Address to listen on; 0.0.0.0 admits the whole network
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1")]
    pub host: IpAddr,
    /// Port to listen on; 0: any free port
    #[arg(long, default_value_t = 8765)]
    pub port: u16,
    #[allow(rustdoc::bare_urls, reason = "`--help` shows the text as it is")]
    /// Also accept web pages of this origin, like https://lab.example:8080; may be repeated. Pages of
    /// this host and of https://app.foxglove.dev are always accepted
    #[arg(long, value_name = "ORIGIN", value_parser = origin)]
    pub allow_origin: Vec<String>,
    /// Also a channel for each robot's sample, forecast, diagnostics and budget
    #[arg(long)]
    pub per_robot: bool,
    /// The fleet's config.
    #[command(flatten)]
    pub config: ConfigFile,
}

/// An origin as browsers send it: a scheme, a host and optionally a port.
fn origin(text: &str) -> Result<String, String> {
    let host = text.split_once("://").map(|(_, host)| host);
    match host {
        Some(host) if !host.is_empty() && !host.contains(['/', ' ', '*']) => Ok(text.to_owned()),
        _ => Err(
            "expected a scheme, a host and optionally a port, such as https://lab.example:8080"
                .to_owned(),
        ),
    }
}
