//! `joulebus doctor`: checks of this host and a fleet.

mod fix;
mod fleet;
mod host;
mod rights;

use std::fmt;
use std::path::PathBuf;

use joulebus_bus::{inspect, removed_files};
use joulebus_program::config_file::ConfigFile;
use joulebus_program::exit::Outcome;
use joulebus_program::output::Output;
use serde::Serialize;

/// Check this host and a fleet's shared memory (exit 1 if something fails), or captures (exit 3)
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus doctor --config configs/fleet.toml\n  \
    joulebus doctor --fix            removes files of dead processes, corrects directory modes\n  \
    joulebus doctor --format json\n  \
    joulebus doctor run.mcap         checks captures instead: checksums, order, losses\n\n\
    Checks change nothing. --fix never touches what live processes use.")]
pub(crate) struct Args {
    /// Captures to check, instead of the host
    #[arg(value_name = "FILE", conflicts_with_all = ["config", "fix"])]
    files: Vec<PathBuf>,
    #[command(flatten)]
    config: ConfigFile,
    /// Remove the files of dead processes, and correct the modes of directories
    #[arg(long)]
    fix: bool,
}

/// Result of a check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Status {
    Ok,
    Warn,
    Fail,
}

#[derive(Debug, Serialize)]
struct Check {
    name: &'static str,
    status: Status,
    found: String,
    /// The remedy. Empty if none is needed.
    remedy: String,
}

impl Check {
    fn ok(name: &'static str, found: impl Into<String>) -> Self {
        Self::new(name, Status::Ok, found, "")
    }

    fn new(
        name: &'static str,
        status: Status,
        found: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self { name, status, found: found.into(), remedy: remedy.into() }
    }
}

#[derive(Debug, Serialize)]
struct DoctorReport {
    status: Status,
    checks: Vec<Check>,
    /// Repairs made by `--fix`.
    mended: Vec<String>,
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    if !args.files.is_empty() {
        return crate::info::diagnose(&args.files, output);
    }
    let config = args.config.load()?;
    let domain = config.domain()?;
    let (mended, trouble) = match args.fix.then(|| fix::fix(&domain)) {
        None => (Vec::new(), None),
        Some(Ok(mended)) => (mended, None),
        Some(Err(error)) => (Vec::new(), Some(error)),
    };
    let inspection = inspect(&domain)?;
    let mut checks = vec![
        host::versions(),
        Check::ok("config", format!("{}: fleet {}", args.config.name(), config.fleet())),
        fleet::models(&config),
        fleet::memory(&config, &inspection),
        fleet::memory_rights(),
        fleet::root(&domain, &inspection),
        fleet::worker(&config, &inspection),
        fleet::nodes(&inspection),
        fleet::removed_files(&removed_files(&domain)),
        fleet::stale_files(&inspection),
    ];
    checks.extend(fleet::permit(&config));
    checks.extend(host::clocks());
    checks.push(rights::scheduling(config.scheduling()));
    if let Some(error) = trouble {
        let found = format!("{error:#}");
        checks.push(Check::new("mending", Status::Fail, found, "see the checks above"));
    }
    let has = |status| checks.iter().any(|check| check.status == status);
    let status = if has(Status::Fail) {
        Status::Fail
    } else if has(Status::Warn) {
        Status::Warn
    } else {
        Status::Ok
    };
    output.report(&DoctorReport { status, checks, mended })?;
    Ok(match status {
        Status::Fail => Outcome::Failed,
        Status::Ok | Status::Warn => Outcome::Done,
    })
}

impl fmt::Display for DoctorReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for done in &self.mended {
            writeln!(out, "mended  {done}")?;
        }
        for check in &self.checks {
            let status = match check.status {
                Status::Ok => "ok  ",
                Status::Warn => "warn",
                Status::Fail => "FAIL",
            };
            writeln!(out, "{status}  {:<14} {}", check.name, check.found)?;
            if !check.remedy.is_empty() {
                writeln!(out, "{:21} → {}", "", check.remedy)?;
            }
        }
        Ok(())
    }
}
