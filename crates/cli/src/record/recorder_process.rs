//! A recorder as a separate process next to a worker: its failure does not affect the worker.

use std::io::{BufRead as _, BufReader, Read as _};
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::Context as _;
use joulebus_program::config_file::ConfigFile;
use joulebus_program::output::log_line;

/// Timeout for the recording to start.
const START_TIMEOUT: Duration = Duration::from_secs(15);

/// The recorder process. Dropping it stops it and waits for it.
pub(crate) struct RecorderProcess {
    process: Child,
    report: Option<JoinHandle<String>>,
}

impl RecorderProcess {
    /// Starts the recorder and waits until it records, so that no output of the worker is missed.
    ///
    /// # Errors
    /// The process cannot be started or does not record. Its output is printed.
    pub(crate) fn start(config: &ConfigFile, file: &Path) -> anyhow::Result<Self> {
        let program =
            std::env::current_exe().context("cannot find the executable of this program")?;
        let mut command = Command::new(program);
        // After a crash the same command begins the next part, as a unit's recorder does.
        command.args(["record", "--exit-with-stdin", "--resume", "--out"]);
        command.arg(file);
        if let Some(config) = &config.config {
            command.arg("--config").arg(config);
        }
        let mut process = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            // Ctrl-C reaches only the worker, which stops the recorder.
            .process_group(0)
            .spawn()
            .context("cannot start the recorder")?;
        let report = process.stdout.take().map(|mut pipe| {
            std::thread::spawn(move || {
                let mut text = String::new();
                // Output before a read error is kept.
                let _ = pipe.read_to_string(&mut text);
                text
            })
        });
        let lines = process.stderr.take().map(pass_on);
        let mut recorder = Self { process, report };
        let records = lines.is_some_and(|lines| lines.recv_timeout(START_TIMEOUT).is_ok());
        if !records {
            // It may wait for a disk that never answers. The worker does not.
            let _ = recorder.process.kill();
            anyhow::bail!("the recorder does not record");
        }
        Ok(recorder)
    }

    /// Stops the recorder, prints its report, and returns true if the capture is complete.
    pub(crate) fn finish(mut self) -> bool {
        self.end()
    }

    fn end(&mut self) -> bool {
        // The recorder stops at the end of its stdin.
        drop(self.process.stdin.take());
        let status = self.process.wait();
        if let Some(report) = self.report.take().and_then(|report| report.join().ok()) {
            log_line(report.trim_end());
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

/// Forwards the recorder's output. Sends one message when it records.
fn pass_on(pipe: impl std::io::Read + Send + 'static) -> Receiver<()> {
    let (ready, is_ready) = channel();
    std::thread::spawn(move || {
        for line in BufReader::new(pipe).lines().map_while(Result::ok) {
            if line.starts_with("recording ") {
                // Fails only if the receiver has timed out.
                let _ = ready.send(());
            }
            log_line(&line);
        }
    });
    is_ready
}
