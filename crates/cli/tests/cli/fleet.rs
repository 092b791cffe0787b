//! A fleet for one test: its config, shared memory, and processes.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::{PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard, TryLockError};
use std::thread;
use std::time::Duration;

use joulebus_config::Config;
use joulebus_testkit::{Child, PATIENCE, lab_beside, left_behind};
use rustix::process::Signal;
use serde_json::Value;

pub(crate) fn joulebus<A: AsRef<OsStr>>(arguments: impl IntoIterator<Item = A>) -> Command {
    let program = env!("CARGO_BIN_EXE_joulebus");
    // It runs this one for the verbs on recordings and models.
    let _ = lab_beside(program);
    let mut command = Command::new(program);
    command.args(arguments).env_remove("JOULEBUS_LOG");
    command
}

pub(crate) fn output<A: AsRef<OsStr>>(arguments: impl IntoIterator<Item = A>) -> Output {
    joulebus(arguments).output().unwrap()
}

/// The output of a command that succeeds.
#[track_caller]
pub(crate) fn done<A: AsRef<OsStr>>(arguments: impl IntoIterator<Item = A>) -> Output {
    output(arguments).exits(0)
}

pub(crate) trait Exits {
    /// The same, if this is its exit code.
    fn exits(self, code: i32) -> Self;
}

impl Exits for Output {
    #[track_caller]
    fn exits(self, wanted: i32) -> Self {
        assert_eq!(code(&self), wanted, "{}{}", stdout(&self), stderr(&self));
        self
    }
}

pub(crate) fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

pub(crate) fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

pub(crate) fn code(output: &Output) -> i32 {
    output.status.code().unwrap_or_else(|| panic!("killed: {output:?}"))
}

pub(crate) fn json(output: &Output) -> Value {
    serde_json::from_str(&stdout(output)).unwrap_or_else(|error| panic!("{error}: {output:?}"))
}

/// A path with the robot, or the platform, of what is recorded there.
pub(crate) fn at(path: &Path, robots: &str) -> PathBuf {
    format!("{}@{robots}", path.display()).into()
}

/// True if the program of a row is built: some verbs are programs of the workspace.
pub(crate) fn is_built(row: &str) -> bool {
    let verb = row.split(' ').next().unwrap_or_default();
    if !["serve", "bridge", "link", "bench"].contains(&verb) {
        return true;
    }
    let program =
        Path::new(env!("CARGO_BIN_EXE_joulebus")).with_file_name(format!("joulebus-{verb}"));
    let is_there = program.exists();
    if !is_there {
        println!("skipped: {verb}: {} is not built", program.display());
        assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "{verb} is missing");
    }
    is_there
}

/// Held by demonstrations, whose roots are where programs look for fleets: `joulebus status` joins
/// those, and until it leaves their files stay.
static SEEN: RwLock<()> = RwLock::new(());

/// While it lives, no test runs `joulebus status`.
pub(crate) fn seen() -> RwLockReadGuard<'static, ()> {
    SEEN.read().unwrap_or_else(PoisonError::into_inner)
}

/// While it lives, no test runs a demonstration. Never before those that wait for one that runs.
pub(crate) fn sees_all() -> RwLockWriteGuard<'static, ()> {
    loop {
        match SEEN.try_write() {
            Ok(alone) => return alone,
            Err(TryLockError::Poisoned(alone)) => return alone.into_inner(),
            Err(TryLockError::WouldBlock) => thread::sleep(Duration::from_millis(20)),
        }
    }
}

pub(crate) struct Fleet {
    directory: tempfile::TempDir,
    /// Folder of the root.
    _shared: tempfile::TempDir,
    root: PathBuf,
    prefix: String,
}

impl Fleet {
    pub(crate) fn new() -> Self {
        // Not where `joulebus status` of another test looks for fleets, see `SEEN`.
        let shared = tempfile::Builder::new().prefix("jbcli-").tempdir_in("/dev/shm").unwrap();
        let root = shared.path().join("root");
        let directory = tempfile::tempdir().unwrap();
        let text = format!(
            "[fleet]\nname = \"cli\"\ncapacity = 20\n\
             [domain]\nroot = \"{}\"\nprefix = \"jbcli_\"\n\
             [intake]\nmax_sources = 4\n[readers]\nmax_planners = 4\n\
             [ledger]\ncheckpoint = \"\"\n\
             [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-9\"]\n\
             [[platform]]\nfile = \"builtin:rover\"\nrobots = [\"100-109\"]\n",
            root.display()
        );
        fs::write(directory.path().join("fleet.toml"), text).unwrap();
        let config = Config::load(directory.path().join("fleet.toml")).unwrap();
        let prefix = config.domain().unwrap().shm_prefix().to_owned();
        Self { directory, _shared: shared, root, prefix }
    }

    /// The same with another name.
    pub(crate) fn named(name: &str) -> Self {
        let fleet = Self::new();
        let text = fs::read_to_string(fleet.config()).unwrap();
        fs::write(fleet.config(), text.replace("name = \"cli\"", &format!("name = \"{name}\"")))
            .unwrap();
        fleet
    }

    pub(crate) fn config(&self) -> PathBuf {
        self.path("fleet.toml")
    }

    pub(crate) fn root(&self) -> &Path {
        &self.root
    }

    /// Prefix of the fleet's objects in shared memory.
    pub(crate) fn prefix(&self) -> &str {
        &self.prefix
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.directory.path().join(name)
    }

    /// A command with the words of `verb` and the fleet's config.
    pub(crate) fn joulebus(&self, verb: &str) -> Command {
        let mut command = joulebus(verb.split_whitespace());
        command.arg("--config").arg(self.config());
        command
    }

    pub(crate) fn output(&self, verb: &str) -> Output {
        self.joulebus(verb).output().unwrap()
    }

    /// A recording of `rows` rows at 30 Hz whose power changes in every row, and does not repeat.
    pub(crate) fn recording(&self, name: &str, rows: u32) -> PathBuf {
        let mut text = "timestamp_s,power_mW,v_cmd_mps,omega_cmd_radps\n".to_owned();
        for row in 0..rows {
            let time_s = f64::from(row) / 30.0;
            // Recordings of as many rows are the same, others have nothing in common.
            let mut bits =
                (u64::from(rows) << 32 | u64::from(row)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            bits = (bits ^ (bits >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            // Neighbours differ.
            let power_mw = 3_600 + 2 * ((bits >> 40) % 499) + u64::from(row % 2);
            text += &format!("{time_s},{power_mw},0.1,{}\n", f64::from(row % 5) * 0.1);
        }
        let path = self.path(name);
        fs::write(&path, text).unwrap();
        path
    }

    /// Starts a worker and waits until it is ready.
    pub(crate) fn worker(&self) -> Program {
        let mut worker = Program::start(self.joulebus("run --format json"));
        worker.wait_for_stderr("ready:");
        worker
    }

    /// Remaining files of the fleet.
    pub(crate) fn stale_files(&self) -> Vec<PathBuf> {
        left_behind(&self.prefix, &self.root)
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        for path in self.stale_files() {
            let _ = fs::remove_file(&path).or_else(|_| fs::remove_dir_all(&path));
        }
    }
}

/// A process of the test.
pub(crate) struct Program(Child);

impl Program {
    pub(crate) fn start(command: Command) -> Self {
        Self(Child::spawn("joulebus", command))
    }

    pub(crate) fn pid(&self) -> u32 {
        self.0.pid()
    }

    pub(crate) fn wait_for_stderr(&mut self, text: &str) {
        self.0.wait_for_line(text);
    }

    pub(crate) fn wait_for_stdout(&mut self, text: &str) {
        let mut read = 0;
        loop {
            let lines = self.0.lines(read, PATIENCE);
            assert!(!lines.is_empty(), "no {text:?} on stdout");
            if lines.iter().any(|line| line.contains(text)) {
                return;
            }
            read += lines.len();
        }
    }

    /// Its lines on stdout so far.
    pub(crate) fn shown(&mut self) -> Vec<String> {
        self.0.lines(0, std::time::Duration::ZERO)
    }

    pub(crate) fn signal(&mut self, signal: Signal) {
        self.0.signal(signal);
    }

    /// Its lines on stderr so far.
    pub(crate) fn printed(&self) -> Vec<String> {
        self.0.errors().lines().map(str::to_owned).collect()
    }

    /// Sends `signal` and waits for the exit.
    pub(crate) fn end(mut self, signal: Signal) -> Output {
        self.signal(signal);
        self.wait()
    }

    pub(crate) fn wait(mut self) -> Output {
        let ended = self.0.wait();
        Output {
            status: ended.status,
            stdout: ended.text().into_bytes(),
            stderr: ended.errors().into_bytes(),
        }
    }
}
