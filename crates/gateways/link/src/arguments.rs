//! Command-line options of `joulebus link`.

use std::path::PathBuf;

use joulebus_program::config_file::ConfigFile;

/// Join a fleet over several hosts: samples of robots elsewhere, forecasts for planners elsewhere
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus link configs/links/worker.toml     on the host of the worker, beside `joulebus run`\n  \
    joulebus link configs/links/robots.toml     on a host where robots publish, instead of `joulebus run`\n  \
    joulebus link configs/links/planners.toml   on a host where planners read, instead of `joulebus run`\n  \
    joulebus link configs/links/standby.toml    on the host of a worker that is one of several, beside `joulebus run --standby`
  \
    joulebus link my-link.toml --check          only checks the file\n  \
    joulebus link my-link.toml --take-over      this host's worker serves, in place of another's\n\n\
    FILE says what this host gives and takes, and how it reaches the others (zenoh): docs/reference/link-file.md. Planners, \
    `ask`, `watch`, `record` and `serve` work on a linked host as beside the worker. It connects again by itself. \
    Every host of a fleet needs the same release and the same config of the fleet.\n\n\
    Exit codes: 0 ended by a signal; 1 the fleet cannot be joined, it has a worker already, or the network is \
    refused; 2 a wrong option, config or FILE; 3 frames were lost on the way, or refused.")]
pub(crate) struct LinkArguments {
    /// What is linked
    #[arg(value_name = "FILE")]
    pub(crate) file: PathBuf,
    /// Only check FILE, and say what it does
    #[arg(long)]
    pub(crate) check: bool,
    /// Have the worker of this host serve its shard, in place of another host's: of those that
    /// FILE's shards name, one does
    #[arg(long, conflicts_with = "check")]
    pub(crate) take_over: bool,
    /// The fleet's config.
    #[command(flatten)]
    pub(crate) config: ConfigFile,
}
