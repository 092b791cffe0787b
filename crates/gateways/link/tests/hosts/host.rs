//! A host of a test: its own shared memory, and its own network namespace if the test makes one.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};

use joulebus_config::Config;
use joulebus_testkit::{Child, eventually, free_port, joulebus_beside, left_behind, remove};
use serde_json::Value;

use crate::planner::Reader;

/// The `joulebus` program of the same build.
pub(crate) fn joulebus() -> &'static Path {
    joulebus_beside(env!("CARGO_BIN_EXE_joulebus-link"))
}

/// A host, as one fleet knows it.
pub(crate) struct Host {
    directory: tempfile::TempDir,
    namespace: Option<String>,
}

impl Host {
    pub(crate) fn new() -> Self {
        Self::within(None)
    }

    /// Creates a host of a fleet with that many robots.
    pub(crate) fn of(robots: usize) -> Self {
        Self::with(None, robots)
    }

    pub(crate) fn within(namespace: Option<String>) -> Self {
        Self::with(namespace, 10)
    }

    fn with(namespace: Option<String>, robots: usize) -> Self {
        Self::of_fleet(namespace, Self::number(), "lab", 0..robots)
    }

    /// Two fleets on one host, the second one with the ids after those of the first.
    pub(crate) fn of_two(robots: usize) -> [Self; 2] {
        let number = Self::number();
        let of_fleet = |name, ids| Self::of_fleet(None, number, name, ids);
        [of_fleet("north", 0..robots), of_fleet("south", robots..2 * robots)]
    }

    fn number() -> u32 {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        NUMBER.fetch_add(1, Ordering::Relaxed)
    }

    fn of_fleet(
        namespace: Option<String>,
        number: u32,
        fleet: &str,
        robots: std::ops::Range<usize>,
    ) -> Self {
        let root = format!("/dev/shm/jblink-{}-{number}", std::process::id());
        let capacity = robots.len().max(20);
        let (first, last) = (robots.start, robots.end - 1);
        let text = format!(
            "[fleet]\nname = \"{fleet}\"\ncapacity = {capacity}\n\
             [domain]\nroot = \"{root}\"\nprefix = \"jbl{number}_\"\n\
             [intake]\nmax_sources = 6\nleave_after_s = 60\n[readers]\nmax_planners = 10\n\
             [ledger]\ncheckpoint = \"\"\n\
             [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"{first}-{last}\"]\n\
             [platform.battery]\ncapacity_wh = 10\ninitial_soc = 1\ninitial_soc_lo = 0.9\n"
        );
        let directory = tempfile::tempdir().unwrap();
        fs::write(directory.path().join("fleet.toml"), text).unwrap();
        Self { directory, namespace }
    }

    pub(crate) fn config(&self) -> PathBuf {
        self.directory.path().join("fleet.toml")
    }

    /// The fleet as this host sees it. `None` if no frame comes within the three seconds of the
    /// watch.
    pub(crate) fn watched(&self) -> Option<Value> {
        let words = ["watch", "--once", "--format", "json"];
        let watched = Child::spawn("watch", self.joulebus(&words)).wait();
        (watched.code() == Some(0)).then(|| watched.json())
    }

    /// Number of samples that this host's worker has accepted or dropped. `None` while it is not
    /// seen.
    pub(crate) fn known_samples(&self) -> Option<u64> {
        let report = self.watched()?;
        let dropped = report["samples_dropped"].as_object()?.values();
        let dropped: u64 = dropped.filter_map(Value::as_u64).sum();
        Some(report["samples_accepted"].as_u64()? + dropped)
    }

    /// Writes a file beside this host's other files.
    pub(crate) fn write(&self, name: &str, text: &str) {
        fs::write(self.directory.path().join(name), text).unwrap();
    }

    fn command(&self, program: &Path) -> Command {
        let mut command = match &self.namespace {
            Some(namespace) => {
                let mut command = Command::new("ip");
                command.args(["netns", "exec", namespace]).arg(program);
                command
            }
            None => Command::new(program),
        };
        command.env_remove("JOULEBUS_LOG");
        command
    }

    /// The `joulebus` program with these arguments and this host's config.
    pub(crate) fn joulebus(&self, words: &[&str]) -> Command {
        let mut command = self.bare_joulebus(words);
        command.arg("--config").arg(self.config());
        command
    }

    /// The `joulebus` program with these arguments alone.
    pub(crate) fn bare_joulebus(&self, words: &[&str]) -> Command {
        let mut command = self.command(joulebus());
        command.args(words);
        command
    }

    pub(crate) fn worker(&self) -> Child {
        let mut worker = Child::spawn("run", self.joulebus(&["run", "--format", "json"]));
        worker.wait_for_line("ready:");
        worker
    }

    pub(crate) fn robots(&self, words: &[&str]) -> Child {
        let words = [&["publish", "sim", "--seed", "3"], words].concat();
        Child::spawn("sim", self.joulebus(&words))
    }

    /// Reads a file beside this host's other files.
    pub(crate) fn read(&self, name: &str) -> String {
        fs::read_to_string(self.directory.path().join(name)).unwrap()
    }

    /// The program `joulebus-link` with these arguments, in the folder of this host's files.
    pub(crate) fn program(&self, words: &[&str]) -> Command {
        let mut command = self.command(Path::new(env!("CARGO_BIN_EXE_joulebus-link")));
        command.args(words).current_dir(self.directory.path());
        command
    }

    /// The command of a link with this file, not started.
    pub(crate) fn link_command(&self, text: &str) -> Command {
        let path = self.directory.path().join("link.toml");
        fs::write(&path, text).unwrap();
        let mut command = self.command(Path::new(env!("CARGO_BIN_EXE_joulebus-link")));
        command.args(["--format", "json"]).arg(path);
        command.arg("--config").arg(self.config());
        command
    }

    /// Starts a link with this file, and waits until it is open.
    pub(crate) fn link(&self, text: &str) -> Child {
        let mut command = self.link_command(text);
        command.env("JOULEBUS_LOG", "joulebus_link=debug");
        let mut link = Child::spawn("link", command);
        link.wait_for_line("is open");
        link
    }

    pub(crate) fn planner(&self) -> Reader {
        Reader::join(&self.config())
    }

    /// Files that the fleet has left behind.
    pub(crate) fn stale_files(&self) -> Vec<PathBuf> {
        let domain = Config::load(self.config()).unwrap().domain().unwrap();
        left_behind(domain.shm_prefix(), domain.root())
    }
}

/// Removes what killed processes have left.
impl Drop for Host {
    fn drop(&mut self) {
        self.stale_files().iter().for_each(|path| remove(path));
    }
}

/// Waits until the named link has requested frames of `link`, which sends them from then on.
pub(crate) fn is_asked_by(link: &Child, name: &str) {
    let expected = format!("link {name} asks for ");
    // The request may arrive before the link logs that it is open.
    eventually(&expected, || link.errors().contains(&expected));
}

/// True if the link has logged that the robots' host is gone or silent, or messages missing.
pub(crate) fn has_lost_edge(link: &Child) -> bool {
    let errors = link.errors();
    let logged = [
        "the link of edge is gone",
        "no samples come from edge",
        "messages are missing from=\"edge\"",
    ];
    logged.iter().any(|text| errors.contains(text))
}

/// Times that nothing came from a link, of an entry of `taken` of its report.
pub(crate) fn silences(taken: &Value) -> u64 {
    taken["silences"].as_u64().unwrap()
}

/// The silences and the messages lost of an entry of `taken`.
pub(crate) fn disturbances(taken: &Value) -> u64 {
    silences(taken) + taken["lost"].as_u64().unwrap()
}

/// Maximum number of attempts at a scene.
pub(crate) const ATTEMPTS: usize = 5;

/// Repeats a scene that allows no lost message until it had none. `scene` returns its
/// [`disturbances`]. A link that gets no processor for a second counts as gone, and its messages in
/// flight are lost. A message that finds the queue full for 50 ms is lost as well. Both are
/// counted, as promised.
pub(crate) fn undisturbed(mut scene: impl FnMut() -> u64) {
    let is_undisturbed = (0..ATTEMPTS).any(|_| scene() == 0);
    assert!(is_undisturbed, "messages were lost, {ATTEMPTS} times");
}

/// An address of this host that nobody listens on and no other test gets.
pub(crate) fn free_address() -> String {
    format!("tcp/127.0.0.1:{}", free_port())
}

/// The file of a worker's link.
pub(crate) fn of_worker(address: &str, takes: &[&str]) -> String {
    let takes: String =
        takes.iter().map(|from| format!("[[worker.take]]\nfrom = \"{from}\"\n")).collect();
    format!("name = \"base\"\n[network]\nlisten = [\"{address}\"]\n{TLS_OR_NOT}[worker]\n{takes}")
}

/// The file of another host's link.
pub(crate) fn of_other(name: &str, address: &str, sides: &str) -> String {
    format!("name = \"{name}\"\n[network]\nconnect = [\"{address}\"]\n{TLS_OR_NOT}{sides}")
}

const TLS_OR_NOT: &str = "unencrypted = true\n";

pub(crate) const SAMPLES: &str = "[samples]\nto = \"base\"\n";
pub(crate) const FOLLOW: &str = "[follow]\nworker = \"base\"\n";
