//! Command-line options of `joulebus link`.

use std::path::PathBuf;

use joulebus_program::config_file::ConfigFile;

/// Join a fleet over several hosts: samples of robots elsewhere, forecasts for planners elsewhere
#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
#[command(after_help = "Examples:\n  \
    joulebus link init base=10.0.0.1 edge-1     writes the files and certificates of both, and says what to copy\n  \
    joulebus link configs/links/worker.toml     on the host of the worker, beside `joulebus run`\n  \
    joulebus link configs/links/robots.toml     on a host where robots publish, instead of `joulebus run`\n  \
    joulebus link configs/links/planners.toml   on a host where planners read, instead of `joulebus run`\n  \
    joulebus link configs/links/standby.toml    on the host of a worker that is one of several, beside `joulebus run --standby`
  \
    joulebus link my-link.toml --check          only checks the file and its certificate\n\n\
    FILE says what this host gives and takes, and how it reaches the others (zenoh): docs/reference/link-file.md. Planners, \
    `ask`, `watch`, `record` and `serve` work on a linked host as beside the worker. A link \
    connects again by itself. Every host of a fleet needs the same release and the same config of \
    the fleet.\n\n\
    Exit code 0: ended by a signal. 1: the fleet cannot be joined, it has a worker already, or \
    the network is refused. 2: a wrong option, config or FILE. 3: frames were lost on the way, or \
    refused.")]
pub(crate) struct LinkArguments {
    /// The link's file
    #[arg(value_name = "FILE", required = true)]
    pub(crate) file: Option<PathBuf>,
    #[command(subcommand)]
    pub(crate) verb: Option<LinkVerb>,
    /// Only check FILE, and say what the link does. With TLS, also check that name, certificate and
    /// key fit
    #[arg(long)]
    pub(crate) check: bool,
    /// The fleet's config.
    #[command(flatten)]
    pub(crate) config: ConfigFile,
}

#[derive(Debug, clap::Subcommand)]
pub(crate) enum LinkVerb {
    Init(InitArguments),
    /// Carry messages of `joulebus bridge`, which starts it, as ROS 2's rmw_zenoh does
    #[command(hide = true)]
    RmwZenoh,
}

/// Write the files of links between hosts, with certificates of the fleet's own authority
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus link init base=10.0.0.1 edge-1 edge-2            below ./links, for three hosts\n  \
    joulebus link init base=10.0.0.1 edge-1 edge-2 edge-3     one more: what is there stays\n  \
    joulebus link init base=10.0.0.1 edge-1 --replace         new files, keys and certificates of both\n\n\
    The authority's key, fleet-ca.key, signs all of them: keep it off the hosts.")]
pub(crate) struct InitArguments {
    /// Names of the links, the worker's host first. ADDRESS is the host name or IP address by which
    /// others reach a host, if it is not NAME
    #[arg(value_name = "NAME[=ADDRESS]", num_args = 2.., required = true)]
    pub(crate) hosts: Vec<String>,
    /// Folder of the authority, with a folder for each host
    #[arg(long, value_name = "DIR", default_value = "links")]
    pub(crate) out: PathBuf,
    /// Port on which the worker's host listens
    #[arg(long, value_name = "PORT", default_value_t = 7447, value_parser = clap::value_parser!(u16).range(1..))]
    pub(crate) port: u16,
    /// Days for which certificates are valid
    #[arg(long, value_name = "DAYS", default_value_t = 825, value_parser = clap::value_parser!(u32).range(1..=3650))]
    pub(crate) days: u32,
    /// Replace folders that are there, but keep the authority
    #[arg(long)]
    pub(crate) replace: bool,
}
