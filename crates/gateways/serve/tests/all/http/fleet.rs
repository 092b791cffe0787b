//! A fleet of real processes.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};

use joulebus_config::Config;
use joulebus_testkit::{Child, joulebus_beside, left_behind, remove};

/// The `joulebus` program of the same build.
fn joulebus() -> &'static Path {
    joulebus_beside(env!("CARGO_BIN_EXE_joulebus-serve"))
}

/// The fleet of one test. What its processes have left fails the test when it is dropped.
pub(crate) struct Fleet {
    directory: tempfile::TempDir,
    pub(crate) config: Config,
}

impl Fleet {
    pub(crate) fn new() -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let root = format!("/dev/shm/jbhttp-{}-{number}", std::process::id());
        let text = format!(
            "[fleet]\nname = \"http\"\ncapacity = 40\n\
             [domain]\nroot = \"{root}\"\nprefix = \"jbhttp_\"\n\
             [intake]\nmax_sources = 4\n[readers]\nmax_planners = 8\n\
             [ledger]\ncheckpoint = \"\"\n\
             [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-19\"]\n\
             [[platform]]\nfile = \"builtin:rover\"\nrobots = [\"100-109\"]\n"
        );
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("fleet.toml");
        fs::write(&path, text).unwrap();
        let config = Config::load(path).unwrap();
        Self { directory, config }
    }

    pub(crate) fn path(&self) -> PathBuf {
        self.directory.path().join("fleet.toml")
    }

    pub(crate) fn file(&self, name: &str) -> PathBuf {
        self.directory.path().join(name)
    }

    /// Starts a verb of the program. It is ended when it is dropped.
    pub(crate) fn joulebus(&self, words: &str) -> Child {
        let mut command = Command::new(joulebus());
        command.args(words.split(' ')).arg("--config").arg(self.path());
        command.env_remove("JOULEBUS_LOG");
        Child::spawn(words, command).at_drop(Child::end)
    }

    pub(crate) fn worker(&self) -> Child {
        let mut worker = self.joulebus("run");
        worker.wait_for_line("ready:");
        worker.at_drop(Child::stop)
    }

    /// Starts a server on a free port. Returns it with its address.
    pub(crate) fn serve(&self, more: &[&str]) -> (Child, String) {
        self.serving(self.serve_command(more))
    }

    /// The command of a server on a free port, not started.
    pub(crate) fn serve_command(&self, more: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_joulebus-serve"));
        if !more.contains(&"--http") {
            command.args(["--http", "127.0.0.1:0"]);
        }
        command.args(["--format", "json", "--config"]).arg(self.path());
        command.args(more).env_remove("JOULEBUS_LOG");
        command
    }

    /// Starts a server, and returns it with its address.
    pub(crate) fn serving(&self, command: Command) -> (Child, String) {
        let mut server = Child::spawn("serve", command);
        let line = server.wait_for_line("serving fleet http at http://");
        let address = line.rsplit('/').next().unwrap().to_owned();
        (server.at_drop(Child::stop), address)
    }

    /// Starts a server at a Unix socket alone.
    pub(crate) fn serve_at(&self, socket: &Path) -> Child {
        let mut server = self.serve_at_any(socket);
        server.wait_for_line("serving fleet http at /");
        server
    }

    /// The same, without waiting until it serves.
    pub(crate) fn serve_at_any(&self, socket: &Path) -> Child {
        self.serve_alone(&["--socket", socket.to_str().unwrap()])
    }

    /// Starts a server by these arguments alone.
    pub(crate) fn serve_alone(&self, words: &[&str]) -> Child {
        let mut command = Command::new(env!("CARGO_BIN_EXE_joulebus-serve"));
        command.args(words).arg("--config").arg(self.path()).env_remove("JOULEBUS_LOG");
        Child::spawn("serve", command)
    }

    /// Files left behind by the fleet.
    pub(crate) fn stale_files(&self) -> Vec<PathBuf> {
        let domain = self.config.domain().unwrap();
        left_behind(domain.shm_prefix(), domain.root())
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        let left = self.stale_files();
        left.iter().for_each(|path| remove(path));
        assert!(left.is_empty() || std::thread::panicking(), "left behind: {left:?}");
    }
}
