//! Starts the processes of a fleet, reaps them (a zombie counts as alive, and its shared memory
//! stays), and stops them all.
//!
//! Each child has its own process group, so that Ctrl-C reaches only the supervisor, which stops
//! the children in order. Their stdin is a pipe that is closed when the supervisor exits for any
//! reason ([`joulebus_program::exit_with_parent`]).

mod child;

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitStatus;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

use anyhow::Context as _;

use child::Child;

/// Hidden flag of every subcommand: exit when stdin is closed.
const EXIT_WITH_STDIN: &str = "--exit-with-stdin";
/// Polling interval for exits while waiting for a process.
const POLL_INTERVAL: Duration = Duration::from_millis(5);
/// Time to exit after SIGTERM when all processes are stopped.
const GRACE: Duration = Duration::from_secs(3);

/// A process to run: this program with a subcommand.
#[derive(Debug, Clone)]
pub(crate) struct Task {
    pub(crate) name: &'static str,
    pub(crate) arguments: Vec<OsString>,
}

/// An event of a process.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Event {
    Started {
        name: &'static str,
        pid: u32,
    },
    /// The process wrote a line to stderr.
    Output {
        name: &'static str,
        line: String,
    },
    /// The process exited unexpectedly or could not be started.
    Exited {
        name: &'static str,
        /// Its pid. None if it could not be started.
        pid: Option<u32>,
        /// Exit status or error.
        how: String,
    },
}

impl std::fmt::Display for Event {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Started { name, pid } => write!(out, "{name} runs as process {pid}"),
            Self::Output { name, line } => write!(out, "{name}: {line}"),
            Self::Exited { name, pid, how } => {
                let pid = pid.map_or_else(String::new, |pid| format!(" (process {pid})"));
                write!(out, "{name}{pid} {how}")
            }
        }
    }
}

/// Result of a process that was asked to stop.
#[derive(Debug)]
pub(crate) struct Ended {
    /// Its exit status. None if it was not running.
    pub(crate) status: Option<ExitStatus>,
    pub(crate) stdout: String,
}

struct Job {
    task: Task,
    phase: Phase,
}

/// State of a process.
enum Phase {
    Added,
    Running(Child),
    /// The process was asked to stop. It is killed at this time.
    Stopping(Child, Instant),
    Ended(Ended),
}

/// The processes of a fleet. Dropping it stops them all and waits for them.
pub(crate) struct Supervisor {
    program: PathBuf,
    jobs: Vec<Job>,
    lines: Receiver<(&'static str, String)>,
    line_sender: Sender<(&'static str, String)>,
}

impl Supervisor {
    /// A supervisor without processes. They will run this program's executable.
    pub(crate) fn new() -> anyhow::Result<Self> {
        let program =
            std::env::current_exe().context("cannot find the executable of this program")?;
        let (line_sender, lines) = channel();
        Ok(Self { program, jobs: Vec::new(), lines, line_sender })
    }

    /// Adds a task. [`Supervisor::poll`] starts it.
    pub(crate) fn add(&mut self, task: Task) {
        self.jobs.push(Job { task, phase: Phase::Added });
    }

    /// Reaps the processes that have exited, starts those that were added, and returns the events.
    /// Must be called often.
    pub(crate) fn poll(&mut self) -> Vec<Event> {
        let mut events = Vec::new();
        for job in &mut self.jobs {
            events.extend(job.step(&self.program, &self.line_sender));
        }
        events.extend(self.lines.try_iter().map(|(name, line)| Event::Output { name, line }));
        events
    }

    /// Asks the task's process to stop, kills it after `grace`, reaps it, and returns its result.
    /// The other processes are supervised meanwhile.
    pub(crate) fn end(&mut self, name: &str, grace: Duration, events: &mut Vec<Event>) -> Ended {
        self.request_stop(|task| task == name, grace);
        loop {
            events.extend(self.poll());
            let job = self.jobs.iter_mut().find(|job| job.task.name == name);
            match job.map(|job| &mut job.phase) {
                Some(Phase::Ended(ended)) => return std::mem::replace(ended, Ended::NEVER),
                Some(_) => std::thread::sleep(POLL_INTERVAL),
                None => return Ended::NEVER,
            }
        }
    }

    /// Stops all processes and waits for them.
    pub(crate) fn end_all(&mut self) -> Vec<Event> {
        let mut events = Vec::new();
        self.request_stop(|_| true, GRACE);
        while !self.jobs.iter().all(|job| matches!(job.phase, Phase::Ended(_))) {
            events.extend(self.poll());
            std::thread::sleep(POLL_INTERVAL);
        }
        events.extend(self.poll());
        events
    }

    fn request_stop(&mut self, which: impl Fn(&str) -> bool, grace: Duration) {
        for job in self.jobs.iter_mut().filter(|job| which(job.task.name)) {
            job.phase = match std::mem::replace(&mut job.phase, Phase::Ended(Ended::NEVER)) {
                Phase::Added => Phase::Ended(Ended::NEVER),
                Phase::Running(mut child) => {
                    child.terminate();
                    Phase::Stopping(child, Instant::now() + grace)
                }
                other => other,
            };
        }
    }
}

impl Drop for Supervisor {
    fn drop(&mut self) {
        self.end_all();
    }
}

impl Ended {
    const NEVER: Self = Self { status: None, stdout: String::new() };
}

impl Job {
    /// Starts the process, kills it when it is time, or reaps it.
    fn step(&mut self, program: &Path, lines: &Sender<(&'static str, String)>) -> Option<Event> {
        let name = self.task.name;
        let mut event = None;
        self.phase = match std::mem::replace(&mut self.phase, Phase::Ended(Ended::NEVER)) {
            Phase::Added => match Child::start(program, &self.task, lines.clone()) {
                Ok(child) => {
                    event = Some(Event::Started { name, pid: child.pid() });
                    Phase::Running(child)
                }
                Err(error) => {
                    let how = format!("could not be started: {error}");
                    event = Some(Event::Exited { name, pid: None, how });
                    Phase::Ended(Ended::NEVER)
                }
            },
            Phase::Running(mut child) => match child.try_wait() {
                Some(status) => {
                    let how = format!("ended with {status}");
                    event = Some(Event::Exited { name, pid: Some(child.pid()), how });
                    Phase::Ended(Ended { status: Some(status), stdout: child.stdout() })
                }
                None => Phase::Running(child),
            },
            Phase::Stopping(mut child, kill_at) => match child.try_wait() {
                Some(status) => {
                    Phase::Ended(Ended { status: Some(status), stdout: child.stdout() })
                }
                None => {
                    if Instant::now() >= kill_at {
                        child.kill();
                    }
                    Phase::Stopping(child, kill_at)
                }
            },
            ended @ Phase::Ended(_) => ended,
        };
        event
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shell(script: &str) -> Supervisor {
        let (line_sender, lines) = channel();
        let mut supervisor =
            Supervisor { program: PathBuf::from("/bin/sh"), jobs: Vec::new(), lines, line_sender };
        // The flag appended to the arguments is the script's $0.
        let arguments = vec![OsString::from("-c"), OsString::from(script)];
        supervisor.add(Task { name: "shell", arguments });
        supervisor
    }

    fn poll_until(supervisor: &mut Supervisor, done: impl Fn(&[Event]) -> bool) -> Vec<Event> {
        let mut events = Vec::new();
        for _ in 0..2_000 {
            events.extend(supervisor.poll());
            if done(&events) {
                return events;
            }
            std::thread::sleep(POLL_INTERVAL);
        }
        panic!("not within 10 s: {events:?}");
    }

    fn printed(events: &[Event], text: &str) -> usize {
        let is = |event: &&Event| matches!(event, Event::Output { line, .. } if line == text);
        events.iter().filter(is).count()
    }

    #[test]
    fn a_process_that_ends_by_itself_is_reaped_once_and_told() {
        let mut supervisor = shell("exit 7");
        let died = |event: &Event| matches!(event, Event::Exited { .. });
        let mut events = poll_until(&mut supervisor, |events| events.iter().any(died));
        events.extend(supervisor.poll());
        let died: Vec<&Event> = events.iter().filter(|event| died(event)).collect();
        let [Event::Exited { pid: Some(pid), how, .. }] = died[..] else { panic!("{events:?}") };
        assert!(how.contains('7'), "{how}");
        assert!(!Path::new(&format!("/proc/{pid}")).exists());
        assert_eq!(supervisor.end("shell", GRACE, &mut events).status.unwrap().code(), Some(7));
    }

    #[test]
    fn a_process_that_cannot_be_started_is_told() {
        let mut supervisor = shell("");
        supervisor.program = PathBuf::from("/nowhere");
        let events = supervisor.poll();
        assert!(events[0].to_string().starts_with("shell could not be started: "), "{events:?}");
        assert!(supervisor.end_all().is_empty(), "it is not started again");
    }

    #[test]
    fn output_of_a_stopped_process_is_kept() {
        let mut supervisor =
            shell("trap 'echo bye; exit 0' TERM; echo up >&2; while :; do sleep 0.01; done");
        let mut events = poll_until(&mut supervisor, |events| printed(events, "up") == 1);
        let ended = supervisor.end("shell", Duration::from_secs(10), &mut events);
        assert!(ended.status.unwrap().success());
        assert_eq!(ended.stdout, "bye\n");
    }

    #[test]
    fn a_process_that_ignores_sigterm_is_killed() {
        let mut supervisor = shell("trap '' TERM; echo up >&2; while :; do sleep 0.01; done");
        let mut events = poll_until(&mut supervisor, |events| printed(events, "up") == 1);
        let ended = supervisor.end("shell", Duration::from_millis(20), &mut events);
        let status = ended.status.unwrap();
        assert_eq!(std::os::unix::process::ExitStatusExt::signal(&status), Some(9));
    }

    #[test]
    fn stdin_closes_with_the_supervisor() {
        // SIGTERM is ignored, but `cat` exits at the end of its input, long before the kill.
        let mut supervisor = shell("trap '' TERM; echo up >&2; cat; exit 3");
        let mut events = poll_until(&mut supervisor, |events| printed(events, "up") == 1);
        let ended = supervisor.end("shell", Duration::from_secs(60), &mut events);
        assert_eq!(ended.status.unwrap().code(), Some(3));
    }
}
