//! A child process, its pipes and its exit.

use std::io::{self, BufRead as _, BufReader, Read as _};
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};
use std::sync::mpsc::Sender;
use std::thread::JoinHandle;

use rustix::process::{Pid, Signal, kill_process};

use super::{EXIT_WITH_STDIN, Task};

pub(super) struct Child {
    process: std::process::Child,
    stdout: Option<JoinHandle<String>>,
    stderr: Option<JoinHandle<()>>,
}

impl Child {
    /// Starts `program`. Each line of its stderr is sent to `lines`.
    pub(super) fn start(
        program: &Path,
        task: &Task,
        lines: Sender<(&'static str, String)>,
    ) -> io::Result<Self> {
        let mut process = Command::new(program)
            .args(&task.arguments)
            .arg(EXIT_WITH_STDIN)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .process_group(0)
            .spawn()?;
        let stdout = process.stdout.take().map(|mut pipe| {
            std::thread::spawn(move || {
                let mut bytes = Vec::new();
                // Output before a read error is kept.
                let _ = pipe.read_to_end(&mut bytes);
                String::from_utf8_lossy(&bytes).into_owned()
            })
        });
        let name = task.name;
        let stderr = process.stderr.take().map(|pipe| {
            std::thread::spawn(move || {
                for line in BufReader::new(pipe).split(b'\n').map_while(Result::ok) {
                    let line = String::from_utf8_lossy(&line).into_owned();
                    // The pipe must be drained even if nobody receives the lines.
                    let _ = lines.send((name, line));
                }
            })
        });
        Ok(Self { process, stdout, stderr })
    }

    pub(super) fn pid(&self) -> u32 {
        self.process.id()
    }

    pub(super) fn terminate(&mut self) {
        drop(self.process.stdin.take());
        // Not reaped yet, so the pid is not reused. The process may be a zombie.
        if let Some(pid) = Pid::from_raw(self.process.id().cast_signed()) {
            let _ = kill_process(pid, Signal::TERM);
        }
    }

    pub(super) fn kill(&mut self) {
        // Fails only if the process has exited.
        let _ = self.process.kill();
    }

    /// The exit status, once the process has exited. Reaps it.
    pub(super) fn try_wait(&mut self) -> Option<ExitStatus> {
        self.process.try_wait().ok().flatten()
    }

    /// The text on stdout, once the process has exited.
    pub(super) fn stdout(mut self) -> String {
        let text = self.stdout.take().and_then(|reader| reader.join().ok());
        if let Some(reader) = self.stderr.take() {
            let _ = reader.join();
        }
        text.unwrap_or_default()
    }
}
