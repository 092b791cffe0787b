//! `joulebus serve`.

use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;

use clap::ArgGroup;

use joulebus_program::config_file::ConfigFile;

/// Show a fleet to people and programs: a page, a JSON API and metrics, or all messages in
/// Foxglove, live
#[derive(Debug, clap::Args)]
#[command(
    group = ArgGroup::new("what").required(true).multiple(true).args(["http", "socket", "foxglove", "webhook", "webhooks"]),
    after_help = "Examples:\n  \
    joulebus serve --http                                  http://127.0.0.1:8630\n  \
    joulebus serve --http 0.0.0.0:8630 --token-file token  for other hosts, who need the token\n  \
    joulebus serve --socket /run/joulebus-serve/lab.sock   for users of this host who may enter its folder\n  \
    joulebus serve --http --foxglove\n  \
    joulebus serve --webhook https://hooks.example/fleet   each raise and end of an alarm\n  \
    joulebus serve --webhooks configs/webhooks/people.toml Slack, Teams, other messages\n  \
    joulebus serve --webhooks configs/webhooks/pager.toml  Alertmanager, signed requests\n  \
    joulebus serve --foxglove --per-robot --port 9000\n  \
    joulebus serve --foxglove --allow-origin https://lab.example\n\n\
    --http: the page at /, the API at /api/v1/openapi.json, OpenMetrics at /metrics, /healthz and \
    /readyz. An address that other hosts reach needs --token-file, a file of mode 0600 with one \
    line of at least 16 characters. Browsers open /?token=TOKEN once. Programs send \
    `Authorization: Bearer TOKEN`. There is no TLS: docs/how-to/open-the-page.md shows a reverse \
    proxy.\n\n\
    --socket: the same at a Unix socket of mode 0660, without a token. Whoever may enter its \
    folder and is in its group can read the fleet, ask what plans cost and acknowledge alarms. \
    They can change nothing else. `curl --unix-socket FILE http://localhost/api/v1/fleet`.\n\n\
    --webhook: a POST with JSON, {\"fleet\", \"changes\": [what `joulebus alarms --format json` prints, …]}, up to \
    100 changes each. Changes that the receiver does not take (no answer within 10 s, 5xx, 408, \
    425, 429) are sent again after 1 s, 2 s … 60 s. Up to 10,000 changes wait. Other answers \
    refuse them.\n\n\
    --webhooks: receivers in a file, each with a body of its own (Slack, Teams, Alertmanager, a \
    template), and signed where it has a secret: docs/how-to/webhook.md. `joulebus config explain \
    webhook` has the keys.\n\n\
    --foxglove: in Foxglove, Open connection, Foxglove WebSocket, ws://127.0.0.1:8765. Then \
    import the layout \
    configs/foxglove/joulebus.json. The topics and schemas are those of a capture. Only this host \
    can connect unless --host names another address. There is no password, so whoever can connect \
    sees everything. Web pages from elsewhere are refused. A handshake may take 5 s, and 64 \
    connections are taken at once.\n\n\
    Exit code 0: ended by a signal. 1: the address or the fleet cannot be used. 2: a wrong \
    option, config or token file. 3: messages to Foxglove, or changes of alarms, were lost."
)]
pub(crate) struct ServeArguments {
    /// Serve the page, API and metrics at this address [default: 127.0.0.1:8630]
    #[arg(long, value_name = "ADDRESS:PORT", num_args = 0..=1, default_missing_value = "127.0.0.1:8630")]
    pub(crate) http: Option<SocketAddr>,
    /// Serve page, API and metrics at this Unix socket
    #[arg(long, value_name = "FILE")]
    pub(crate) socket: Option<PathBuf>,
    /// With --http: clients need the token in this file (mode 0600)
    #[arg(long, value_name = "FILE", requires = "http")]
    pub(crate) token_file: Option<PathBuf>,
    /// With --http: a name that this server is reached by, such as that of a reverse proxy (may be
    /// repeated)
    #[arg(long, value_name = "NAME", requires = "http")]
    pub(crate) allow_host: Vec<String>,
    /// With --http: the address of a reverse proxy whose `X-Forwarded-For` says who asks (may be
    /// repeated). Without it all its clients share one allowance of requests
    #[arg(long, value_name = "ADDRESS", requires = "http")]
    pub(crate) proxy: Vec<IpAddr>,
    /// With --http or --socket: metrics of at most this many robots (0: only of the fleet)
    #[arg(long, value_name = "N", default_value_t = 100)]
    pub(crate) metrics_robots: usize,
    /// Tell this address of alarms, or with @FILE the address in this file (mode 0600)
    #[arg(long, value_name = "ADDRESS")]
    pub(crate) webhook: Option<String>,
    /// With --webhook: check its certificate against those in this file (PEM) instead of Mozilla's
    /// list
    #[arg(long, value_name = "FILE", requires = "webhook")]
    pub(crate) webhook_ca: Option<PathBuf>,
    /// Tell the receivers in this file of alarms
    #[arg(long, value_name = "FILE")]
    pub(crate) webhooks: Option<PathBuf>,
    /// Serve the Foxglove WebSocket protocol
    #[arg(long)]
    pub(crate) foxglove: bool,
    /// With --foxglove: address to listen on (0.0.0.0 admits the whole network)
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1", requires = "foxglove")]
    pub(crate) host: IpAddr,
    /// With --foxglove: port to listen on (0: any free port)
    #[arg(long, default_value_t = 8765, requires = "foxglove")]
    pub(crate) port: u16,
    #[allow(rustdoc::bare_urls, reason = "`--help` shows the text as it is")]
    /// With --foxglove: also accept web pages of this origin, like https://lab.example:8080 (may be
    /// repeated). Pages of this host and of https://app.foxglove.dev are always accepted
    #[arg(long, value_name = "ORIGIN", value_parser = origin, requires = "foxglove")]
    pub(crate) allow_origin: Vec<String>,
    /// With --foxglove: also a channel for each robot's sample, forecast, diagnostics and budget
    #[arg(long, requires = "foxglove")]
    pub(crate) per_robot: bool,
    /// The fleet's config.
    #[command(flatten)]
    pub(crate) config: ConfigFile,
}

/// An origin as browsers send it: a scheme, a host and optionally a port.
fn origin(text: &str) -> Result<String, String> {
    let host = text.split_once("://").map(|(_, host)| host);
    match host {
        Some(host) if !host.is_empty() && !host.contains(['/', ' ', '*']) => Ok(text.to_owned()),
        _ => {
            Err("expected a scheme, a host and optionally a port, such as https://lab.example:8080"
                .to_owned())
        }
    }
}
