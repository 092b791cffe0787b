//! A separate fleet for each test.

use std::fmt::Write as _;
use std::fs;
use std::os::unix::fs::DirBuilderExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};

use joulebus_bus::Domain;
use joulebus_testkit::left_behind;

use crate::{Child, Ended, Planner, ReaderLine, Source};

static ARENAS: AtomicU32 = AtomicU32::new(0);
const FLEET: &str = "t";
const PREFIX: &str = "jbt_";

/// Config of an arena.
#[derive(Debug, Clone)]
pub struct Setup {
    /// `fleet.capacity`.
    pub capacity: u32,
    /// `tick.policy`.
    pub policy: &'static str,
    /// `tick.rate_hz`.
    pub tick_hz: f64,
    /// `intake.leave_after_s`.
    pub leave_after_s: f64,
    /// `intake.max_sources`.
    pub max_sources: u32,
    /// `intake.buffer_frames`.
    pub buffer_frames: u32,
    /// `readers.max_planners`.
    pub max_planners: u32,
    /// True if the ledger is saved to [`Arena::ledger`], at most every 50 ms.
    pub ledger: bool,
    /// True if the config has nothing on the ledger.
    pub default_ledger: bool,
    /// File of the only platform.
    pub platform: &'static str,
    pub robots: &'static str,
    /// `platform.rate_hz`.
    pub rate_hz: f64,
    /// `platform.stale_after_s`.
    pub stale_after_s: f64,
    /// `platform.model`; the platform's own if not set.
    pub model: Option<PathBuf>,
    /// Further lines at the end, in the platform's section.
    pub more: String,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            capacity: 100,
            policy: "on_frame",
            tick_hz: 200.0,
            leave_after_s: 60.0,
            max_sources: 4,
            buffer_frames: 8,
            max_planners: 4,
            ledger: false,
            default_ledger: false,
            platform: "builtin:gternal",
            robots: "0-99",
            // Slower than the tests send: however long a process waits for a CPU, no sample is
            // overdue and no robot silent by the worker's clock.
            rate_hz: 1.0,
            stale_after_s: 30.0,
            model: None,
            more: String::new(),
        }
    }
}

impl Setup {
    /// For [`Arena::simulate`] with a recorder: ticks wait for late robots.
    pub fn simulated() -> Self {
        Self {
            tick_hz: 60.0,
            rate_hz: 30.0,
            stale_after_s: 10.0,
            buffer_frames: 64,
            ..Self::default()
        }
    }

    /// Period of the platform's samples, ns.
    pub fn period_ns(&self) -> u64 {
        (1e9 / self.rate_hz) as u64
    }

    fn toml(&self, root: &Path, ledger: &Path) -> String {
        let mut text = format!(
            "[fleet]\nname = \"{FLEET}\"\ncapacity = {}\n\
             [domain]\nroot = \"{}\"\nprefix = \"{PREFIX}\"\n\
             [tick]\npolicy = \"{}\"\nrate_hz = {:?}\ndeadline_ms = {:?}\n\
             [intake]\nmax_sources = {}\nbuffer_frames = {}\nleave_after_s = {:?}\n\
             [readers]\nmax_planners = {}\n",
            self.capacity,
            root.display(),
            self.policy,
            self.tick_hz,
            300.0 / self.tick_hz,
            self.max_sources,
            self.buffer_frames,
            self.leave_after_s,
            self.max_planners,
        );
        // Writing to a string cannot fail.
        let ledger = if self.ledger { ledger } else { Path::new("") };
        if !self.default_ledger {
            let _ =
                write!(text, "[ledger]\ncheckpoint = \"{}\"\nevery_s = 0.05\n", ledger.display());
        }
        let _ = write!(
            text,
            "[[platform]]\nfile = \"{}\"\nrobots = [\"{}\"]\n\
             rate_hz = {:?}\nstale_after_s = {:?}\nhold_max_s = {:?}\n",
            self.platform,
            self.robots,
            self.rate_hz,
            self.stale_after_s,
            f64::max(1.0, 1.0 / self.rate_hz),
        );
        if let Some(model) = &self.model {
            let _ = writeln!(text, "model = \"{}\"", model.display());
        }
        text + &self.more
    }
}

/// A separate fleet: directories, config, shared memory. When it is dropped, all its processes have
/// exited, and a file that is left fails the test.
#[derive(Debug)]
pub struct Arena {
    files: PathBuf,
    domain: Domain,
}

impl Arena {
    /// Creates the directories and writes the config.
    pub fn new(setup: &Setup) -> Self {
        let number = ARENAS.fetch_add(1, Ordering::Relaxed);
        let name = format!("jbt-{}-{number}", std::process::id());
        let shm = Path::new("/dev/shm");
        let (files, root) = (shm.join(format!("{name}.f")), shm.join(name));
        let domain = Domain::new(FLEET, &root, PREFIX).expect("valid names");
        fs::DirBuilder::new().mode(0o755).create(&files).expect("the name is unique to this test");
        let arena = Self { files, domain };
        arena.configure(setup);
        arena
    }

    pub fn configure(&self, setup: &Setup) {
        let text = setup.toml(self.domain.root(), &self.ledger());
        fs::write(self.config(), text).expect("writable directory");
    }

    /// Its domain in shared memory.
    pub const fn domain(&self) -> &Domain {
        &self.domain
    }

    /// A directory for the test's files, outside the fleet's root.
    pub fn files(&self) -> &Path {
        &self.files
    }

    pub fn config(&self) -> PathBuf {
        self.files.join("fleet.toml")
    }

    pub fn ledger(&self) -> PathBuf {
        self.files.join("ledger.json")
    }

    /// A command of the program under test with `arguments` and the arena's config.
    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(program("joulebus-under-test"));
        command.args(arguments).arg("--config").arg(self.config());
        // Not into the user's own.
        command.env("XDG_STATE_HOME", self.state()).env_remove("STATE_DIRECTORY");
        command
    }

    /// Directory in which its programs save their state by default.
    pub fn state(&self) -> PathBuf {
        self.files.join("state")
    }

    /// Runs the program under test until it exits.
    pub fn run(&self, arguments: &[&str]) -> Ended {
        let mut child = Child::spawn(&arguments.join(" "), self.command(arguments));
        child.wait()
    }

    /// Simulates robots with the program under test until the worker has accepted that many more of
    /// their frames; the same robots each time. The simulation must succeed. A busy machine takes
    /// longer.
    pub fn simulate(&self, robots: u32, frames: u64) {
        let mut planner = self.consumer();
        let count = robots.to_string();
        let command = self.command(&["publish", "sim", "--seed", "7", "--robots", &count]);
        let mut source = Child::spawn("simulation", command);
        let mut wanted = None;
        planner.until_beside(&mut source, "the frames are accepted", |line| match line {
            ReaderLine::Given { accepted, .. } => {
                let wanted = wanted.get_or_insert(accepted + frames * u64::from(robots));
                (*accepted >= *wanted).then_some(())
            }
            _ => None,
        });
        source.stop();
        planner.leave();
    }

    /// Starts `joulebus record` into `file` with the arguments `more` and a JSON report, and waits
    /// until it records.
    pub fn recording(&self, file: &Path, more: &[&str]) -> Child {
        let name = file.to_str().expect("ASCII file name");
        let arguments = [&["record", "--format", "json", "-o", name], more].concat();
        let mut child = Child::spawn("recorder", self.command(&arguments));
        child.wait_for_line(&format!("recording {FLEET} into"));
        child
    }

    /// Command of the worker: `joulebus run` with a JSON report that logs its cleanup.
    pub fn worker_command(&self) -> Command {
        self.command(&["run", "--format", "json", "--verbose"])
    }

    /// Starts a worker without waiting until it is ready.
    pub fn spawn_worker(&self) -> Child {
        Child::spawn("worker", self.worker_command())
    }

    /// Starts a worker and waits until it is ready.
    pub fn worker(&self) -> Child {
        let mut worker = self.spawn_worker();
        worker.wait_for_line("ready:");
        worker.at_drop(Child::stop)
    }

    /// The probe as a command.
    pub fn probe(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(program("joulebus-probe"));
        command.args(arguments).arg(self.config());
        command
    }

    /// Starts the probe. It is finished when it is dropped.
    pub fn member(&self, name: &str, arguments: &[&str]) -> Child {
        Child::spawn(name, self.probe(arguments)).at_drop(Child::finish)
    }

    /// Starts a source controlled by the test and waits until it has joined.
    pub fn source(&self, name: &str) -> Source {
        Source::new(self.member(name, &["source", name]))
    }

    /// Starts a controller: a publisher that sends [`crate::steady`] samples of `robots` robots
    /// from `first` on at `rate_hz` until it is stopped. Does not wait for it.
    pub fn controller(&self, name: &str, first: u32, robots: u32, rate_hz: f64) -> Child {
        let numbers = [first.to_string(), robots.to_string(), rate_hz.to_string()];
        let arguments = ["controller", name, &numbers[0], &numbers[1], &numbers[2]];
        self.member(name, &arguments)
    }

    /// Starts a planner that reports every frame, and waits until it has joined.
    pub fn planner(&self) -> Planner {
        Planner::ready(self.member("planner", &["planner"]))
    }

    /// Starts a planner built on the consumer library, and waits until it has joined.
    pub fn consumer(&self) -> Planner {
        Planner::ready(self.member("consumer", &["consumer"]))
    }

    /// Starts a reader of samples beside the worker, and waits until it has joined.
    pub fn recorder(&self) -> Planner {
        Planner::ready(self.member("recorder", &["recorder"]))
    }

    /// Files left of the fleet: objects in shared memory, and the root directory with its drafts.
    pub fn stale_files(&self) -> Vec<PathBuf> {
        left_behind(self.domain.shm_prefix(), self.domain.root())
    }
}

impl Drop for Arena {
    fn drop(&mut self) {
        let left = self.stale_files();
        for path in &left {
            let _ = fs::remove_file(path).or_else(|_| fs::remove_dir_all(path));
        }
        let _ = fs::remove_dir_all(&self.files);
        assert!(left.is_empty() || std::thread::panicking(), "left behind: {left:?}");
    }
}

/// Runs the program under test until it exits, with a JSON report and without a config, as a user
/// who has only a capture.
pub fn alone(arguments: &[&str]) -> Ended {
    let mut command = Command::new(program("joulebus-under-test"));
    command.args(["--format", "json"]).args(arguments);
    Child::spawn(&arguments.join(" "), command).wait()
}

/// Records until nothing is lost, at most five times: a recorder that waits too long for a CPU
/// loses messages and exits with code 3. `record` is given the number of the attempt.
pub fn without_loss<T>(mut record: impl FnMut(usize) -> (T, Ended)) -> (T, Ended) {
    const ATTEMPTS: usize = 5;
    for attempt in 0..ATTEMPTS {
        let (recorded, ended) = record(attempt);
        match ended.code() {
            Some(0) => return (recorded, ended),
            Some(3) => println!("a recorder lost messages, attempt {attempt}"),
            _ => panic!("{ended:?}"),
        }
    }
    panic!("the recorder lost messages {ATTEMPTS} times");
}

/// Path of a program of this package: cargo builds it before the tests, next to them.
pub fn program(name: &str) -> PathBuf {
    let mut path = std::env::current_exe().expect("Linux tells");
    path.pop();
    if path.ends_with("deps") {
        path.pop();
    }
    path.join(name)
}
