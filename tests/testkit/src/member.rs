//! The test binary restarted as a member of a fleet, which can be stopped and killed.

use std::process::Command;
use std::time::Duration;

use rustix::process::{Pid, Signal, WaitOptions, waitpid};

use crate::{Child, Ended, PATIENCE};

/// Marks the lines of members among the output of the test runner.
const MARK: &str = "@ ";

/// A member in a separate process. Members and tests exchange lines.
#[derive(Debug)]
pub struct Member {
    child: Child,
    lines_read: usize,
}

impl Member {
    /// The command of the calling test binary with its test `member` selected.
    ///
    /// # Panics
    /// Linux always reports which program runs.
    pub fn command() -> Command {
        let mut command = Command::new(std::env::current_exe().expect("Linux tells"));
        command.args(["--exact", "member", "--nocapture", "--test-threads=1"]);
        command
    }

    /// Starts a member; `name` is used in messages.
    pub fn spawn(name: &str, command: Command) -> Self {
        Self { child: Child::spawn(name, command), lines_read: 0 }
    }

    /// Starts a member that is finished when it is dropped: it ends with its stdin.
    pub fn spawn_to_finish(name: &str, command: Command) -> Self {
        let child = Child::spawn(name, command).at_drop(Child::finish);
        Self { child, lines_read: 0 }
    }

    pub fn pid(&self) -> u32 {
        self.child.pid()
    }

    /// Sends it a line. A killed member does not answer, which the test detects.
    pub fn send_line(&mut self, line: &str) {
        self.child.send_line(line);
    }

    /// Its next line.
    ///
    /// # Panics
    /// The process has exited, or prints nothing for [`PATIENCE`].
    pub fn next_line(&mut self) -> String {
        self.try_next_line(PATIENCE).unwrap_or_else(|| panic!("no line: {}", self.child.tail()))
    }

    /// Its next line, if it prints one within `time`.
    pub fn try_next_line(&mut self, time: Duration) -> Option<String> {
        loop {
            let lines = self.child.lines(self.lines_read, time);
            if lines.is_empty() {
                return None;
            }
            for line in lines {
                self.lines_read += 1;
                // The test runner may have written the start of the line.
                if let Some((_, text)) = line.split_once(MARK) {
                    return Some(text.to_owned());
                }
            }
        }
    }

    /// Sends a line and returns its answer.
    pub fn ask(&mut self, line: &str) -> String {
        self.send_line(line);
        self.next_line()
    }

    /// Sends SIGSTOP; the process is stopped when this returns.
    ///
    /// # Panics
    /// The process has exited.
    pub fn stop(&mut self) {
        self.child.signal(Signal::STOP);
        let pid = Pid::from_raw(self.pid().cast_signed());
        let stopped = waitpid(pid, WaitOptions::UNTRACED).ok().flatten();
        assert!(stopped.is_some_and(|(_, status)| status.stopped()));
    }

    pub fn resume(&mut self) {
        self.child.signal(Signal::CONT);
    }

    /// Sends SIGKILL and waits for the exit.
    pub fn kill(mut self) {
        self.child.kill();
    }

    /// Sends SIGKILL, waits for the exit, and returns all lines that it has sent to the test.
    pub fn all_lines(mut self) -> Vec<String> {
        let lines = self.child.kill().stdout;
        let sent = lines.iter().filter_map(|line| line.split_once(MARK));
        sent.map(|(_, text)| text.to_owned()).collect()
    }

    /// Closes its stdin and waits for the exit with any status.
    pub fn close(mut self) -> Ended {
        self.child.close()
    }

    /// Closes its stdin and waits for the exit, which must succeed.
    pub fn finish(mut self) {
        self.child.finish();
    }

    /// Waits for the exit.
    pub fn wait(&mut self) -> Ended {
        self.child.wait()
    }
}

/// In a member: sends a line to the test.
pub fn send_to_test(line: impl std::fmt::Display) {
    println!("{MARK}{line}");
}
