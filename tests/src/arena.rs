//! A fleet of its own for each test.

use std::fmt::Write as _;
use std::fs;
use std::os::unix::fs::DirBuilderExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};

use joulebus_bus::Domain;

use crate::{Child, Ended, Planner, ReaderLine, Source};

static ARENAS: AtomicU32 = AtomicU32::new(0);
const FLEET: &str = "t";
const PREFIX: &str = "jbt_";

/// What an arena's config says.
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
    /// Whether the ledger is saved, to [`Arena::ledger`], each 50 ms at most.
    pub ledger: bool,
    /// Robots of the one platform, a GTernal.
    pub robots: &'static str,
    /// `platform.rate_hz`.
    pub rate_hz: f64,
    /// `platform.stale_after_s`.
    pub stale_after_s: f64,
    /// `platform.model`; that of the platform when not set.
    pub model: Option<PathBuf>,
    /// Further text at the end, within the platform.
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
            robots: "0-99",
            // Slower than a test sends: however long a process waits for a processor, no sample is
            // overdue and no robot silent by the worker's clock.
            rate_hz: 1.0,
            stale_after_s: 30.0,
            model: None,
            more: String::new(),
        }
    }
}

impl Setup {
    /// For [`Arena::simulate`] and a recorder beside it: frames wait for who is late.
    #[must_use]
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
    #[must_use]
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
        if self.ledger {
            let _ = write!(
                text,
                "[ledger]\ncheckpoint = \"{}\"\nevery_s = 0.05\n",
                ledger.display()
            );
        }
        let _ = write!(
            text,
            "[[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"{}\"]\n\
             rate_hz = {:?}\nstale_after_s = {:?}\nhold_max_s = 1.0\n",
            self.robots, self.rate_hz, self.stale_after_s,
        );
        if let Some(model) = &self.model {
            let _ = writeln!(text, "model = \"{}\"", model.display());
        }
        text + &self.more
    }
}

/// A fleet of its own: directories, config, shared memory. [`Arena::close`] it at the end: nothing
/// may be left then.
#[derive(Debug)]
pub struct Arena {
    files: PathBuf,
    domain: Domain,
    closed: bool,
}

impl Arena {
    /// A new one, with its config written.
    #[must_use]
    pub fn new(setup: &Setup) -> Self {
        let number = ARENAS.fetch_add(1, Ordering::Relaxed);
        let name = format!("jbt-{}-{number}", std::process::id());
        let shm = Path::new("/dev/shm");
        let (files, root) = (shm.join(format!("{name}.f")), shm.join(name));
        let domain = Domain::new(FLEET, &root, PREFIX).expect("short and plain");
        fs::DirBuilder::new()
            .mode(0o755)
            .create(&files)
            .expect("no other test has the name");
        let arena = Self {
            files,
            domain,
            closed: false,
        };
        arena.configure(setup);
        arena
    }

    /// Writes the config again.
    pub fn configure(&self, setup: &Setup) {
        let text = setup.toml(self.domain.root(), &self.ledger());
        fs::write(self.config(), text).expect("the arena's own directory");
    }

    /// Where its shared memory lives.
    #[must_use]
    pub const fn domain(&self) -> &Domain {
        &self.domain
    }

    /// A directory for files of the test, outside the fleet's root.
    #[must_use]
    pub fn files(&self) -> &Path {
        &self.files
    }

    /// The config file.
    #[must_use]
    pub fn config(&self) -> PathBuf {
        self.files.join("fleet.toml")
    }

    /// The ledger's checkpoint.
    #[must_use]
    pub fn ledger(&self) -> PathBuf {
        self.files.join("ledger.json")
    }

    /// The program under test with `arguments` and the arena's config.
    #[must_use]
    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(program("joulebus-under-test"));
        command.args(arguments).arg("--config").arg(self.config());
        command
    }

    /// Runs the program under test to its end.
    #[must_use]
    pub fn run(&self, arguments: &[&str]) -> Ended {
        let mut child = Child::spawn(&arguments.join(" "), self.command(arguments));
        child.wait()
    }

    /// Simulates robots beside a worker until it has accepted so many more frames of them, the same
    /// robots each time: the program under test, which must end well. A busy machine takes longer.
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

    /// Starts `joulebus record` into a file, with more arguments, its report as JSON, and waits until it
    /// records.
    #[must_use]
    pub fn recording(&self, file: &Path, more: &[&str]) -> Child {
        let name = file.to_str().expect("tests name their files in ASCII");
        let arguments = [&["record", "--format", "json", "-o", name], more].concat();
        let mut child = Child::spawn("recorder", self.command(&arguments));
        child.says(&format!("recording {FLEET} into"));
        child
    }

    /// The worker as a command: `joulebus run`, its report as JSON, told to log what it cleans up.
    #[must_use]
    pub fn worker_command(&self) -> Command {
        self.command(&["run", "--format", "json", "--verbose"])
    }

    /// Starts a worker without waiting until it is ready.
    #[must_use]
    pub fn spawn_worker(&self) -> Child {
        Child::spawn("worker", self.worker_command())
    }

    /// Starts a worker and waits until it is ready.
    #[must_use]
    pub fn worker(&self) -> Child {
        let mut worker = self.spawn_worker();
        worker.says("ready:");
        worker
    }

    /// The probe as a command.
    #[must_use]
    pub fn probe(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(program("joulebus-probe"));
        command.args(arguments).arg(self.config());
        command
    }

    /// Starts a source that sends what the test tells it to, and waits until it has joined.
    #[must_use]
    pub fn source(&self, name: &str) -> Source {
        Source::new(Child::spawn(name, self.probe(&["source", name])))
    }

    /// Starts a controller: a real publisher that sends [`crate::steady`] samples of `robots` robots
    /// from `first` on, `rate_hz` times a second, until it is stopped. Does not wait for it.
    #[must_use]
    pub fn controller(&self, name: &str, first: u32, robots: u32, rate_hz: f64) -> Child {
        let numbers = [first.to_string(), robots.to_string(), rate_hz.to_string()];
        let arguments = ["controller", name, &numbers[0], &numbers[1], &numbers[2]];
        Child::spawn(name, self.probe(&arguments))
    }

    /// Starts a planner that tells every frame, and waits until it has joined.
    #[must_use]
    pub fn planner(&self) -> Planner {
        Planner::ready(Child::spawn("planner", self.probe(&["planner"])))
    }

    /// Starts a planner that uses the consumer library, and waits until it has joined.
    #[must_use]
    pub fn consumer(&self) -> Planner {
        Planner::ready(Child::spawn("consumer", self.probe(&["consumer"])))
    }

    /// Starts a reader of samples, beside the worker, and waits until it has joined.
    #[must_use]
    pub fn recorder(&self) -> Planner {
        Planner::ready(Child::spawn("recorder", self.probe(&["recorder"])))
    }

    /// What is left of the fleet: objects in shared memory, and the root directory.
    #[must_use]
    pub fn stale_files(&self) -> Vec<PathBuf> {
        let entries = fs::read_dir("/dev/shm").into_iter().flatten().flatten();
        let prefix = self.domain.shm_prefix();
        let mut found: Vec<PathBuf> = entries
            .filter(|entry| entry.file_name().to_string_lossy().starts_with(prefix))
            .map(|entry| entry.path())
            .collect();
        if self.domain.root().exists() {
            found.push(self.domain.root().to_owned());
        }
        found
    }

    /// Ends the arena: all its processes have ended, and nothing may be left.
    pub fn close(mut self) {
        self.closed = true;
        assert_eq!(self.stale_files(), Vec::<PathBuf>::new(), "left behind");
    }
}

impl Drop for Arena {
    fn drop(&mut self) {
        for path in self.stale_files() {
            let _ = fs::remove_file(&path).or_else(|_| fs::remove_dir_all(&path));
        }
        let _ = fs::remove_dir_all(&self.files);
        if !std::thread::panicking() {
            assert!(
                self.closed,
                "an arena must be closed, or its stale files go unnoticed"
            );
        }
    }
}

/// Runs the program under test to its end without a config, its report as JSON: as somebody who has a
/// capture and nothing else.
#[must_use]
pub fn alone(arguments: &[&str]) -> Ended {
    let mut command = Command::new(program("joulebus-under-test"));
    command.args(["--format", "json"]).args(arguments);
    Child::spawn(&arguments.join(" "), command).wait()
}

/// Records until nothing is lost, five times at most: a recorder that waits too long for a processor loses
/// messages, and says so with exit code 3. Each attempt has its number.
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

/// A program of this package: cargo builds it before the tests, next to them.
#[must_use]
pub fn program(name: &str) -> PathBuf {
    let mut path = std::env::current_exe().expect("Linux tells");
    path.pop();
    if path.ends_with("deps") {
        path.pop();
    }
    path.join(name)
}
