//! A fleet of a test's own: its config, its shared memory, and its programs.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use joulebus_config::Config;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

/// What has not happened after so long never will.
pub(crate) const PATIENCE: Duration = Duration::from_secs(180);

pub(crate) fn joulebus<A: AsRef<OsStr>>(arguments: impl IntoIterator<Item = A>) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_joulebus"));
    command.args(arguments).env_remove("JOULEBUS_LOG");
    command
}

pub(crate) fn output<A: AsRef<OsStr>>(arguments: impl IntoIterator<Item = A>) -> Output {
    joulebus(arguments).output().unwrap()
}

pub(crate) fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

pub(crate) fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

pub(crate) fn code(output: &Output) -> i32 {
    output
        .status
        .code()
        .unwrap_or_else(|| panic!("killed: {output:?}"))
}

pub(crate) fn json(output: &Output) -> Value {
    serde_json::from_str(&stdout(output)).unwrap_or_else(|error| panic!("{error}: {output:?}"))
}

pub(crate) struct Fleet {
    directory: tempfile::TempDir,
    root: PathBuf,
    prefix: String,
}

impl Fleet {
    pub(crate) fn new() -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let root = PathBuf::from(format!("/dev/shm/jbcli-{}-{number}", std::process::id()));
        let directory = tempfile::tempdir().unwrap();
        let text = format!(
            "[fleet]\nname = \"cli\"\ncapacity = 20\n\
             [domain]\nroot = \"{}\"\nprefix = \"jbcli_\"\n\
             [intake]\nmax_sources = 4\n[readers]\nmax_planners = 4\n\
             [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-9\"]\n\
             [[platform]]\nfile = \"builtin:rover\"\nrobots = [\"100-109\"]\n",
            root.display()
        );
        fs::write(directory.path().join("fleet.toml"), text).unwrap();
        let config = Config::load(directory.path().join("fleet.toml")).unwrap();
        let prefix = config.domain().unwrap().shm_prefix().to_owned();
        Self {
            directory,
            root,
            prefix,
        }
    }

    pub(crate) fn config(&self) -> PathBuf {
        self.path("fleet.toml")
    }

    pub(crate) fn root(&self) -> &Path {
        &self.root
    }

    /// How the fleet's objects in shared memory begin.
    pub(crate) fn prefix(&self) -> &str {
        &self.prefix
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.directory.path().join(name)
    }

    /// The words of `verb`, then the fleet's config.
    pub(crate) fn joulebus(&self, verb: &str) -> Command {
        let mut command = joulebus(verb.split_whitespace());
        command.arg("--config").arg(self.config());
        command
    }

    pub(crate) fn output(&self, verb: &str) -> Output {
        self.joulebus(verb).output().unwrap()
    }

    /// A recording of `rows` rows at 30 Hz whose power changes in each of them.
    pub(crate) fn recording(&self, name: &str, rows: u32) -> PathBuf {
        let mut text = "timestamp_s,power_mW,v_cmd_mps,omega_cmd_radps\n".to_owned();
        for row in 0..rows {
            let time_s = f64::from(row) / 30.0;
            let power_mw = 3_600 + row % 97 + 10 * (row % 7);
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

    /// What is left of the fleet.
    pub(crate) fn stale_files(&self) -> Vec<PathBuf> {
        let shared = fs::read_dir("/dev/shm").unwrap().flatten();
        let ours = shared.map(|entry| entry.path()).filter(|path| {
            let name = path.file_name().unwrap().to_string_lossy();
            name.starts_with(&self.prefix)
        });
        ours.chain(self.root.exists().then(|| self.root.clone()))
            .collect()
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        for path in self.stale_files() {
            let _ = fs::remove_file(&path).or_else(|_| fs::remove_dir_all(&path));
        }
    }
}

/// A program that runs beside the test; its stderr goes to a file, so that it never blocks.
pub(crate) struct Program {
    child: Option<Child>,
    log: tempfile::NamedTempFile,
}

impl Program {
    pub(crate) fn start(mut command: Command) -> Self {
        let log = tempfile::NamedTempFile::new().unwrap();
        let child = command
            .stdout(Stdio::piped())
            .stderr(log.reopen().unwrap())
            .spawn()
            .unwrap();
        Self {
            child: Some(child),
            log,
        }
    }

    pub(crate) fn pid(&self) -> u32 {
        self.child.as_ref().unwrap().id()
    }

    pub(crate) fn wait_for_stderr(&mut self, text: &str) {
        let start = Instant::now();
        while !self.stderr().contains(text) {
            let ended = self.child.as_mut().unwrap().try_wait().unwrap();
            assert!(
                ended.is_none(),
                "{ended:?} without {text:?}: {}",
                self.stderr()
            );
            assert!(start.elapsed() < PATIENCE, "no {text:?}: {}", self.stderr());
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    pub(crate) fn stderr(&self) -> String {
        fs::read_to_string(self.log.path()).unwrap()
    }

    pub(crate) fn signal(&self, signal: Signal) {
        let pid = Pid::from_child(self.child.as_ref().unwrap());
        kill_process(pid, signal).unwrap();
    }

    /// Asks it to end, and waits.
    pub(crate) fn end(self, signal: Signal) -> Output {
        self.signal(signal);
        self.wait()
    }

    pub(crate) fn wait(mut self) -> Output {
        let mut child = self.child.take().unwrap();
        let start = Instant::now();
        while child.try_wait().unwrap().is_none() {
            if start.elapsed() > PATIENCE {
                child.kill().unwrap();
                child.wait().unwrap();
                panic!("does not end: {}", self.stderr());
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        // A report is far shorter than what a pipe holds.
        let mut output = child.wait_with_output().unwrap();
        output.stderr = self.stderr().into_bytes();
        output
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        if let Some(mut child) = self.child.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}
