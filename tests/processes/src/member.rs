//! The test binary started again, as a member of a fleet: what one process may do only once, many do.

use std::process::Command;

use rustix::process::{Pid, Signal, WaitOptions, waitpid};

use crate::{Child, Ended, PATIENCE};

/// Marks what members say among what the test runner prints.
const MARK: &str = "@ ";

/// A member in a process of its own. Members and tests talk in lines.
#[derive(Debug)]
pub struct Member {
    child: Child,
    heard: usize,
}

impl Member {
    /// The calling test binary, told to run its test named `member` alone.
    ///
    /// # Panics
    /// Linux always tells which program runs.
    #[must_use]
    pub fn command() -> Command {
        let mut command = Command::new(std::env::current_exe().expect("Linux tells"));
        command.args(["--exact", "member", "--nocapture", "--test-threads=1"]);
        command
    }

    /// Starts one; `name` is what messages call it.
    #[must_use]
    pub fn spawn(name: &str, command: Command) -> Self {
        Self {
            child: Child::spawn(name, command),
            heard: 0,
        }
    }

    /// Its pid.
    #[must_use]
    pub fn pid(&self) -> u32 {
        self.child.pid()
    }

    /// Tells it a line. It may have been killed already: then its answer is missing, which is noticed.
    pub fn tell(&mut self, line: &str) {
        self.child.tell(line);
    }

    /// What it says next.
    ///
    /// # Panics
    /// It has ended, or says nothing for [`PATIENCE`].
    pub fn hear(&mut self) -> String {
        loop {
            let lines = self.child.lines(self.heard, PATIENCE);
            assert!(!lines.is_empty(), "nothing heard: {}", self.child.tail());
            for line in lines {
                self.heard += 1;
                // The runner may have begun the line.
                if let Some((_, said)) = line.split_once(MARK) {
                    return said.to_owned();
                }
            }
        }
    }

    /// Tells it a line; what it answers.
    pub fn ask(&mut self, line: &str) -> String {
        self.tell(line);
        self.hear()
    }

    /// Stops it; it has stopped when this returns.
    ///
    /// # Panics
    /// It has ended.
    pub fn stop(&mut self) {
        self.child.signal(Signal::STOP);
        let pid = Pid::from_raw(self.pid().cast_signed());
        let stopped = waitpid(pid, WaitOptions::UNTRACED).ok().flatten();
        assert!(stopped.is_some_and(|(_, status)| status.stopped()));
    }

    /// Lets it continue.
    pub fn go_on(&mut self) {
        self.child.signal(Signal::CONT);
    }

    /// Kills it with SIGKILL and waits for it.
    pub fn kill(mut self) {
        self.child.kill();
    }

    /// Ends its input, and waits until it has ended, without a failure.
    pub fn finish(mut self) {
        self.child.finish();
    }

    /// Waits for its end.
    pub fn wait(&mut self) -> Ended {
        self.child.wait()
    }
}

/// As a member: says a line to the test.
pub fn say(line: impl std::fmt::Display) {
    println!("{MARK}{line}");
}
