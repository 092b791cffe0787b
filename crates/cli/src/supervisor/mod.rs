//! Starts the processes of a fleet, reaps them (a zombie counts as alive, and its shared memory
//! stays), restarts those that crash, and stops them all.
//!
//! Each child has its own process group, so that Ctrl-C reaches only the supervisor, which stops
//! the children in order. Their stdin is a pipe that is closed when the supervisor exits for any
//! reason ([`joulebus_program::exit_with_parent`]).

mod child;
mod restart_policy;

use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitStatus;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

use anyhow::Context as _;
use joulebus_bus::clock;

use child::Child;
use restart_policy::{RestartPolicy, Step};

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
    /// Subcommand and arguments.
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
    /// The process exited unexpectedly or could not be started. It is restarted after a backoff.
    Exited {
        name: &'static str,
        /// Its pid. None if it could not be started.
        pid: Option<u32>,
        /// Exit status or error.
        how: String,
        /// Backoff before the restart.
        backoff: Duration,
    },
}

impl std::fmt::Display for Event {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Started { name, pid } => write!(out, "{name} runs as process {pid}"),
            Self::Output { name, line } => write!(out, "{name}: {line}"),
            Self::Exited { name, pid, how, backoff } => {
                let pid = pid.map_or_else(String::new, |pid| format!(" (process {pid})"));
                let backoff_ms = backoff.as_millis();
                write!(out, "{name}{pid} {how}, starts again in {backoff_ms} ms")
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
    policy: RestartPolicy,
    child: Option<Child>,
    ended: Option<Ended>,
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
    ///
    /// # Errors
    /// The path of the executable is unknown.
    pub(crate) fn new() -> anyhow::Result<Self> {
        let program =
            std::env::current_exe().context("cannot find the executable of this program")?;
        let (line_sender, lines) = channel();
        Ok(Self { program, jobs: Vec::new(), lines, line_sender })
    }

    /// Adds a task. [`Supervisor::poll`] starts it.
    pub(crate) fn add(&mut self, task: Task) {
        self.jobs.push(Job {
            task,
            policy: RestartPolicy::new(clock::monotonic_ns()),
            child: None,
            ended: None,
        });
    }

    /// Reaps the processes that have exited, starts those that are due, and returns the events.
    /// Must be called often.
    pub(crate) fn poll(&mut self) -> Vec<Event> {
        let now_ns = clock::monotonic_ns();
        let mut events = Vec::new();
        for job in &mut self.jobs {
            job.reap(now_ns, &mut events);
            match job.policy.step(now_ns) {
                Step::Nothing => {}
                Step::Start => job.start(&self.program, &self.line_sender, now_ns, &mut events),
                Step::Kill => {
                    if let Some(child) = &mut job.child {
                        child.kill();
                    }
                }
            }
        }
        events.extend(self.lines.try_iter().map(|(name, line)| Event::Output { name, line }));
        events
    }

    /// True if the task's process runs.
    pub(crate) fn is_running(&self, name: &str) -> bool {
        let job = self.jobs.iter().find(|job| job.task.name == name);
        job.is_some_and(|job| job.policy.is_running())
    }

    /// Asks the task's process to stop, kills it after `grace`, reaps it, and returns its result.
    /// The other processes are supervised meanwhile.
    pub(crate) fn end(&mut self, name: &str, grace: Duration, events: &mut Vec<Event>) -> Ended {
        self.request_stop(|task| task == name, grace);
        loop {
            events.extend(self.poll());
            let job = self.jobs.iter_mut().find(|job| job.task.name == name);
            match job {
                Some(job) if !job.policy.is_stopped() => std::thread::sleep(POLL_INTERVAL),
                Some(job) => return job.ended.take().unwrap_or(Ended::NEVER),
                None => return Ended::NEVER,
            }
        }
    }

    /// Stops all processes and waits for them.
    pub(crate) fn end_all(&mut self) -> Vec<Event> {
        let mut events = Vec::new();
        self.request_stop(|_| true, GRACE);
        while !self.jobs.iter().all(|job| job.policy.is_stopped()) {
            events.extend(self.poll());
            std::thread::sleep(POLL_INTERVAL);
        }
        events.extend(self.poll());
        events
    }

    fn request_stop(&mut self, which: impl Fn(&str) -> bool, grace: Duration) {
        let (now_ns, grace_ns) = (clock::monotonic_ns(), grace.as_nanos() as u64);
        for job in &mut self.jobs {
            if which(job.task.name) {
                if let Some(child) = job.child.as_mut().filter(|_| job.policy.is_running()) {
                    child.terminate();
                }
                job.policy.request_stop(now_ns, grace_ns);
            }
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
    fn start(
        &mut self,
        program: &std::path::Path,
        lines: &Sender<(&'static str, String)>,
        now_ns: u64,
        events: &mut Vec<Event>,
    ) {
        let name = self.task.name;
        match Child::start(program, &self.task, lines.clone()) {
            Ok(child) => {
                let pid = child.pid();
                self.child = Some(child);
                self.policy.started(now_ns);
                events.push(Event::Started { name, pid });
            }
            Err(error) => {
                let how = format!("could not be started: {error}");
                self.died(None, how, now_ns, events);
            }
        }
    }

    fn reap(&mut self, now_ns: u64, events: &mut Vec<Event>) {
        let Some(status) = self.child.as_mut().and_then(Child::try_wait) else {
            return;
        };
        // `try_wait` has just returned its status, so there is one.
        let Some(child) = self.child.take() else {
            return;
        };
        let pid = child.pid();
        let stdout = child.stdout();
        if self.policy.is_running() {
            self.died(Some(pid), format!("ended with {status}"), now_ns, events);
        } else {
            self.ended = Some(Ended { status: Some(status), stdout });
            self.policy.ended(now_ns);
        }
    }

    fn died(&mut self, pid: Option<u32>, how: String, now_ns: u64, events: &mut Vec<Event>) {
        if let Some(backoff_ns) = self.policy.ended(now_ns) {
            events.push(Event::Exited {
                name: self.task.name,
                pid,
                how,
                backoff: Duration::from_nanos(backoff_ns),
            });
        }
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
    fn a_crashed_process_is_reaped_and_restarted() {
        let mut supervisor = shell("echo up >&2; exit 7");
        let events = poll_until(&mut supervisor, |events| printed(events, "up") >= 2);
        let died = events
            .iter()
            .find_map(|event| match event {
                Event::Exited { pid, how, backoff, .. } => Some((pid.unwrap(), how, backoff)),
                _ => None,
            })
            .unwrap();
        assert!(died.1.contains('7'), "{}", died.1);
        assert_eq!(*died.2, Duration::from_millis(100));
        assert!(!std::path::Path::new(&format!("/proc/{}", died.0)).exists());
    }

    #[test]
    fn output_of_a_stopped_process_is_kept() {
        let mut supervisor =
            shell("trap 'echo bye; exit 0' TERM; echo up >&2; while :; do sleep 0.01; done");
        let mut events = poll_until(&mut supervisor, |events| printed(events, "up") == 1);
        let ended = supervisor.end("shell", Duration::from_secs(10), &mut events);
        assert!(ended.status.unwrap().success());
        assert_eq!(ended.stdout, "bye\n");
        assert!(!supervisor.is_running("shell"));
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
