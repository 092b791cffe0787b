//! A recorder beside a worker, in a process of its own: whatever becomes of it, the worker continues.

use std::io::{BufRead as _, BufReader, Read as _};
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::Context as _;
use joulebus_program::config_file::ConfigFile;
use joulebus_program::output::say;

/// How long the recorder may take until it records.
const START_LIMIT: Duration = Duration::from_secs(15);

/// The recorder. Dropping it ends it and waits for it.
pub(crate) struct RecorderProcess {
    process: Child,
    report: Option<JoinHandle<String>>,
}

impl RecorderProcess {
    /// Starts it and waits until it records, so that nothing of the worker is missed.
    ///
    /// # Errors
    /// It cannot be started, or does not record: what it said stands above.
    pub(crate) fn start(config: &ConfigFile, file: &Path) -> anyhow::Result<Self> {
        let program = std::env::current_exe().context("cannot find the program's own file")?;
        let mut command = Command::new(program);
        command.args(["record", "--exit-with-stdin", "--output"]);
        command.arg(file);
        if let Some(config) = &config.config {
            command.arg("--config").arg(config);
        }
        let mut process = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            // Ctrl-C reaches the worker, which ends it.
            .process_group(0)
            .spawn()
            .context("cannot start the recorder")?;
        let report = process.stdout.take().map(|mut pipe| {
            std::thread::spawn(move || {
                let mut text = String::new();
                // What came before an error is still worth something.
                let _ = pipe.read_to_string(&mut text);
                text
            })
        });
        let lines = process.stderr.take().map(pass_on);
        let recorder = Self { process, report };
        let records = lines.is_some_and(|lines| lines.recv_timeout(START_LIMIT).is_ok());
        anyhow::ensure!(records, "the recorder does not record");
        Ok(recorder)
    }

    /// Ends it, tells what it came to, and returns whether the capture is whole.
    pub(crate) fn finish(mut self) -> bool {
        self.end()
    }

    fn end(&mut self) -> bool {
        // It ends when its stdin does.
        drop(self.process.stdin.take());
        let status = self.process.wait();
        if let Some(report) = self.report.take().and_then(|report| report.join().ok()) {
            say(report.trim_end());
        }
        status.is_ok_and(|status| status.success())
    }
}

impl Drop for RecorderProcess {
    fn drop(&mut self) {
        if self.report.is_some() {
            self.end();
        }
    }
}

/// Passes on what it says; tells once when it records.
fn pass_on(pipe: impl std::io::Read + Send + 'static) -> Receiver<()> {
    let (tell, told) = channel();
    std::thread::spawn(move || {
        for line in BufReader::new(pipe).lines().map_while(Result::ok) {
            if line.starts_with("recording ") {
                // Whoever waited has given up, or knows already.
                let _ = tell.send(());
            }
            say(&line);
        }
    });
    told
}
