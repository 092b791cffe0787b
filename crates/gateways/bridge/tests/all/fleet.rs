//! A fleet of real processes with a bridge.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};

use joulebus_config::Config;
use joulebus_testkit::{Child, joulebus_beside, left_behind};
use serde_json::Value;

/// The `joulebus` program of the same build.
fn joulebus() -> &'static Path {
    joulebus_beside(env!("CARGO_BIN_EXE_joulebus-bridge"))
}

pub(crate) struct Fleet {
    directory: tempfile::TempDir,
}

impl Fleet {
    pub(crate) fn new() -> Self {
        Self::with_robots(10)
    }

    /// A fleet of robots from 0 on.
    pub(crate) fn with_robots(robots: u32) -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let root = format!("/dev/shm/jbbridge-{}-{number}", std::process::id());
        let (capacity, last) = (2 * robots, robots - 1);
        let text = format!(
            "[fleet]\nname = \"lab\"\ncapacity = {capacity}\n\
             [domain]\nroot = \"{root}\"\nprefix = \"jbbrdg_\"\n\
             [intake]\nmax_sources = 4\nleave_after_s = 4\n[readers]\nmax_planners = 8\n\
             [ledger]\ncheckpoint = \"\"\n\
             [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-{last}\"]\nhold_max_s = 5\n\
             [platform.battery]\ncapacity_wh = 10\ninitial_soc = 1\ninitial_soc_lo = 0\n"
        );
        let directory = tempfile::tempdir().unwrap();
        fs::write(directory.path().join("fleet.toml"), text).unwrap();
        Self { directory }
    }

    pub(crate) fn config(&self) -> PathBuf {
        self.directory.path().join("fleet.toml")
    }

    /// Starts a source of all robots' samples.
    pub(crate) fn source(&self, robots: u32) -> Child {
        let mut command = Command::new(joulebus());
        command.args(["publish", "sim", "--robots", &robots.to_string(), "--config"]);
        command.arg(self.config()).env_remove("JOULEBUS_LOG");
        Child::spawn("publish", command)
    }

    pub(crate) fn worker(&self) -> Child {
        let mut command = Command::new(joulebus());
        command.args(["run", "--config"]).arg(self.config()).env_remove("JOULEBUS_LOG");
        let mut worker = Child::spawn("run", command);
        worker.wait_for_line("ready:");
        worker
    }

    /// The command of a bridge with this file, not started.
    pub(crate) fn command(&self, text: &str) -> Command {
        let path = self.directory.path().join("bridge.toml");
        fs::write(&path, text).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_joulebus-bridge"));
        command.args(["--format", "json"]).arg(path).arg("--config").arg(self.config());
        command.env_remove("JOULEBUS_LOG");
        command
    }

    /// Starts a bridge, and waits until it logs `expected`.
    pub(crate) fn bridge(&self, text: &str, expected: &str) -> Child {
        let mut bridge = Child::spawn("bridge", self.command(text));
        bridge.wait_for_line(expected);
        bridge
    }

    /// Files that the fleet has left behind.
    pub(crate) fn stale_files(&self) -> Vec<PathBuf> {
        let domain = Config::load(self.config()).unwrap().domain().unwrap();
        left_behind(domain.shm_prefix(), domain.root())
    }
}

/// Messages of a bridge's report that it did not map. Robots that sent nothing for 30 s are left
/// out: on a busy machine a test takes that long.
pub(crate) fn unmapped(report: &Value) -> Vec<&Value> {
    let all = report["unmapped"].as_array().unwrap();
    all.iter().filter(|line| line["reason"] != "never_came").collect()
}
