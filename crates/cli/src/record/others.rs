//! Other fleets in the same file: a recorder joins one fleet, so each of them is recorded by a
//! separate process, into a pipe.

use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use anyhow::Context as _;
use joulebus_program::exit::UsageError;

/// The processes. Dropping it kills those that were not stopped.
pub(super) struct Others(Vec<Child>);

impl Others {
    /// Starts a process for each config except the first. Topics are selected when the file is
    /// written, so the processes send everything.
    pub(super) fn start(configs: &[PathBuf], output: &Path) -> anyhow::Result<Self> {
        let mut others = Self(Vec::new());
        let program = std::env::current_exe().context("cannot find the program's own file")?;
        for config in configs.iter().skip(1) {
            if output == Path::new(super::STDOUT) {
                let what = "several fleets can be recorded to a file, not to a pipe".to_owned();
                return Err(UsageError(what).into());
            }
            let child = Command::new(&program)
                .arg("record")
                .arg("--config")
                .arg(config)
                .args(["-o", super::STDOUT, "--preset", "fastwrite"])
                .args(["--max-bag-duration", "0", "--exit-with-stdin"])
                .stdin(Stdio::piped())
                .stdout(Stdio::piped())
                .spawn()
                .context("cannot start the recorder of another fleet")?;
            others.0.push(child);
        }
        Ok(others)
    }

    pub(super) fn streams(&mut self) -> Vec<Box<dyn Read + Send>> {
        let streams = self.0.iter_mut().filter_map(|child| child.stdout.take());
        streams.map(|stream| Box::new(stream) as Box<dyn Read + Send>).collect()
    }

    /// Requests them to stop, and waits for them.
    pub(super) fn end(&mut self) {
        for child in &mut self.0 {
            // They exit when their stdin closes.
            drop(child.stdin.take());
        }
        for mut child in self.0.drain(..) {
            let _ = child.wait();
        }
    }
}

impl Drop for Others {
    fn drop(&mut self) {
        for child in &mut self.0 {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}
