//! `joulebus status`: the fleets of this host, whose they are, and how they are.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::ffi::OsString;
use std::os::unix::ffi::OsStringExt as _;
use std::path::{Path, PathBuf};
use std::time::Duration;
use std::{fmt, fs};

use joulebus_board::{Board, Link, Reading};
use joulebus_bus::{
    Domain, OtherRoot, WorkerLock, clock, fleets_below, nodes, other_roots, own_roots,
};
use joulebus_config::{Config, default_root};
use joulebus_program::config_file::ConfigFile;
use joulebus_program::exit::Outcome;
use joulebus_program::output::Output;
use serde::Serialize;

/// Longest wait for the frames of one fleet.
const PATIENCE_NS: u64 = 1_000_000_000;

/// List the fleets of this host: whose they are, their workers, and how their robots are
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus status\n  \
    joulebus status --format json | jq '.fleets[] | select(.worker == null)'\n\n\
    It lists the fleets below /dev/shm that this user owns, and that of the config. Of other users \
    it names those who run joulebus, and what to do: only they can read their fleets.")]
pub(crate) struct Args {
    #[command(flatten)]
    config: ConfigFile,
}

#[derive(Debug, Serialize)]
struct Status {
    fleets: Vec<FleetStatus>,
    /// Roots of other users who run joulebus.
    others: Vec<Other>,
}

#[derive(Debug, Serialize)]
struct FleetStatus {
    fleet: String,
    root: PathBuf,
    /// Pid of the worker, or of a link in its place. Null if none runs, 0 if its pid is not visible.
    worker: Option<u32>,
    is_link: bool,
    /// Config of the worker, if it can be read.
    config: Option<PathBuf>,
    /// Null if that is not known.
    robots: Option<Robots>,
    /// Processes of the fleet by name.
    processes: Vec<String>,
}

#[derive(Debug, Serialize)]
struct Robots {
    ok: usize,
    warn: usize,
    error: usize,
    stale: usize,
}

#[derive(Debug, Serialize)]
struct Other {
    found: String,
    remedy: String,
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    // A config that is refused hides no other fleet: `config check` says why.
    let config = args.config.read().ok();
    let mut roots: BTreeSet<PathBuf> = own_roots().into_iter().collect();
    let domain = config.as_ref().and_then(|config| config.domain().ok());
    roots.extend(domain.iter().map(|domain| domain.root().to_owned()));
    let mut fleets = Vec::new();
    for root in &roots {
        for name in fleets_below(root) {
            // Its lock and directory do not depend on the prefix.
            let prefix = domain.as_ref().map_or("jb_", Domain::prefix);
            if let Ok(domain) = Domain::new(&name, root, prefix) {
                fleets.push(FleetStatus::look(&domain, config.as_ref()));
            }
        }
    }
    let mut others = other_roots(&default_root());
    others.extend(domain.iter().flat_map(|domain| other_roots(domain.root())));
    others.sort_by_key(ToString::to_string);
    others.dedup();
    let other = |other: &OtherRoot| Other { found: other.to_string(), remedy: other.remedy() };
    output.report(&Status { fleets, others: others.iter().map(other).collect() })?;
    Ok(Outcome::Done)
}

impl FleetStatus {
    fn look(domain: &Domain, config: Option<&Config>) -> Self {
        let owner = WorkerLock::owner(domain).ok().flatten();
        let pid = owner.and_then(|owner| owner.pid);
        let is_its =
            |config: &Config| (config.fleet(), config.root()) == (domain.fleet(), domain.root());
        let path = pid.and_then(config_of);
        let own = path.as_ref().and_then(|path| Config::load(path).ok());
        let config = own.as_ref().or(config).filter(|config| is_its(config));
        // Names of nodes have the prefix.
        let own = config.and_then(|config| config.domain().ok());
        let all = nodes(own.as_ref().unwrap_or(domain)).unwrap_or_default().into_iter();
        let alive = all.filter(|node| node.alive == Some(true) && !node.name.is_empty());
        let names: BTreeSet<String> = alive.map(|node| node.name).collect();
        Self {
            fleet: domain.fleet().to_owned(),
            root: domain.root().to_owned(),
            worker: owner.map(|owner| owner.pid.unwrap_or_default()),
            is_link: owner.is_some_and(|owner| owner.is_link()),
            config: path.filter(|_| own.is_some()),
            robots: owner.and(config).and_then(robots),
            processes: names.into_iter().collect(),
        }
    }
}

/// The levels of a fleet's robots, if its worker sends frames.
fn robots(config: &Config) -> Option<Robots> {
    let mut reading = Reading::open(config, "status", false).ok()?;
    let board = RefCell::new(Board::new(clock::monotonic_ns()));
    let until_ns = clock::monotonic_ns() + PATIENCE_NS;
    while clock::monotonic_ns() < until_ns {
        reading.poll_within(Duration::from_millis(50), || board.borrow_mut()).ok()?;
        if board.borrow().rows.values().any(|row| row.diagnostic.is_some()) {
            break;
        }
    }
    let board = board.borrow();
    let [ok, warn, error, stale] = board.levels();
    (board.link != Link::Waiting).then_some(Robots { ok, warn, error, stale })
}

/// The file that a process was given with --config, or in JOULEBUS_CONFIG.
fn config_of(pid: u32) -> Option<PathBuf> {
    let process = Path::new("/proc").join(pid.to_string());
    let list = |name: &str| -> Option<Vec<Vec<u8>>> {
        let text = fs::read(process.join(name)).ok()?;
        Some(text.split(|byte| *byte == 0).map(<[u8]>::to_vec).collect())
    };
    let words = list("cmdline")?;
    let after = words.iter().position(|word| word == b"--config").map(|at| words.get(at + 1));
    let joined = || words.iter().find_map(|word| word.strip_prefix(b"--config="));
    let given = after.flatten().map(Vec::as_slice).or_else(joined).map(<[u8]>::to_vec);
    let path = given.or_else(|| {
        list("environ")?
            .iter()
            .find_map(|one| Some(one.strip_prefix(b"JOULEBUS_CONFIG=")?.to_vec()))
    })?;
    Some(fs::read_link(process.join("cwd")).ok()?.join(OsString::from_vec(path)))
}

impl fmt::Display for Status {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.fleets.is_empty() {
            writeln!(out, "no fleet of yours on this host: `joulebus run` starts one")?;
        }
        for fleet in &self.fleets {
            write!(out, "{:<12} yours, {}: ", fleet.fleet, fleet.root.display())?;
            match fleet.worker {
                None => write!(out, "no worker. Start one with `joulebus run`")?,
                Some(0) => write!(out, "a worker in another container")?,
                Some(pid) if fleet.is_link => {
                    write!(out, "worker on another host, link pid {pid}")?;
                }
                Some(pid) => write!(out, "worker pid {pid}")?,
            }
            if let Some(Robots { ok, warn, error, stale }) = fleet.robots {
                let all = ok + warn + error + stale;
                write!(out, ", {all} robots: {ok} ok, {warn} warn, {error} error, {stale} stale")?;
            }
            writeln!(out)?;
            if let Some(config) = &fleet.config {
                writeln!(out, "{:<12} config {}", "", config.display())?;
            }
            if !fleet.processes.is_empty() {
                writeln!(out, "{:<12} processes: {}", "", fleet.processes.join(", "))?;
            }
        }
        for Other { found, remedy } in &self.others {
            writeln!(out, "{found}: {remedy}")?;
        }
        Ok(())
    }
}
