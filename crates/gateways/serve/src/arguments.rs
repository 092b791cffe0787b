//! `joulebus serve`.

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::ArgGroup;

use joulebus_program::config_file::ConfigFile;

/// Show a fleet to people and programs: a page, a JSON API and metrics, and alarms as webhooks
#[derive(Debug, clap::Args)]
#[command(
    group = ArgGroup::new("what").required(true).multiple(true).args(["http", "socket", "webhook", "webhooks"]),
    after_help = "Examples:\n  \
    joulebus serve --http                                  http://127.0.0.1:8630\n  \
    joulebus serve --http 0.0.0.0:8630 --token-file token  for other hosts, who need the token\n  \
    joulebus serve --socket /run/joulebus-serve/lab.sock   for users of this host who may enter its folder\n  \
    joulebus serve --webhook https://hooks.example/fleet   each raise and end of an alarm\n  \
    joulebus serve --webhooks configs/webhooks/receivers.toml\n\n\
    --http: the page at /, the API at /api/v1/openapi.json, metrics for Prometheus at /metrics, \
    /healthz and /readyz. An address that other hosts reach needs --token-file, a file of mode 0600 with one \
    line of at least 16 characters. Browsers open /?token=TOKEN once. Programs send \
    `Authorization: Bearer TOKEN`. There is no TLS: docs/how-to/open-the-page.md shows a reverse \
    proxy.\n\n\
    --socket: the same at a Unix socket of mode 0660, without a token. Whoever may enter its \
    folder and is in its group can read the fleet, ask what plans cost and acknowledge alarms. \
    They can change nothing else. `curl --unix-socket FILE http://localhost/api/v1/fleet`.\n\n\
    --webhook: a POST with JSON, {\"fleet\", \"text\", \"changes\": [what `joulebus alarms --format \
    json` prints, …]}, up to 100 changes each. Slack and Mattermost show the text. Changes that the receiver does not take (no answer within 10 s, 5xx, 408, \
    425, 429) are sent again after 1 s, 2 s … 60 s. Up to 10,000 changes wait. Other answers \
    refuse them.\n\n\
    --webhooks: receivers in a file, each request signed where the receiver has a secret: \
    docs/how-to/webhook.md. `joulebus config explain webhook` has the keys.\n\n\
    Exit code 0: ended by a signal. 1: the address or the fleet cannot be used. 2: a wrong \
    option, config or token file. 3: changes of alarms were lost."
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
    /// With --http or --socket: metrics of at most this many robots (0: only of the fleet)
    #[arg(long, value_name = "N", default_value_t = 100)]
    pub(crate) metrics_robots: usize,
    /// Tell this address of alarms, or with @FILE the address in this file (mode 0600)
    #[arg(long, value_name = "ADDRESS")]
    pub(crate) webhook: Option<String>,
    /// Tell the receivers in this file of alarms
    #[arg(long, value_name = "FILE")]
    pub(crate) webhooks: Option<PathBuf>,
    /// The fleet's config.
    #[command(flatten)]
    pub(crate) config: ConfigFile,
}
