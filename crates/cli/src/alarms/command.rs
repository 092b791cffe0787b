//! The command of `--on-alarm`.

use std::collections::VecDeque;
use std::os::unix::process::CommandExt as _;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use joulebus_consumer::Change;
use joulebus_program::output::log_line;
use rustix::process::{Pid, Signal, kill_process_group};

use super::Line;

/// Changes that wait for the command, and acknowledgements that do.
const MAX_WAITING: usize = 256;
/// Time that a command may take.
const TIMEOUT: Duration = Duration::from_secs(10);
/// Interval between two looks at a running command.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Runs a command for each change, in a thread of its own, so that its caller never waits.
pub(super) struct OnAlarm {
    waiting: Arc<Waiting>,
    thread: Option<JoinHandle<u64>>,
    missed: u64,
}

/// What the command is to be run for. An acknowledgement waits until no other change does: whoever
/// makes many of them keeps no raise from being told.
#[derive(Default)]
struct Waiting {
    lines: Mutex<Lines>,
    news: Condvar,
}

#[derive(Default)]
struct Lines {
    changes: VecDeque<Line>,
    acknowledgements: VecDeque<Line>,
    has_ended: bool,
}

impl Lines {
    /// Adds a change. False if there is no room.
    fn push(&mut self, line: &Line) -> bool {
        let is_acknowledgement = line.0.change == Change::Acknowledged.name();
        let lines = if is_acknowledgement { &mut self.acknowledgements } else { &mut self.changes };
        let has_room = lines.len() < MAX_WAITING;
        if has_room {
            lines.push_back(line.clone());
        }
        has_room
    }

    fn pop(&mut self) -> Option<Line> {
        self.changes.pop_front().or_else(|| self.acknowledgements.pop_front())
    }
}

impl Waiting {
    fn change<R>(&self, change: impl FnOnce(&mut Lines) -> R) -> R {
        let changed = change(&mut self.lines.lock().unwrap_or_else(PoisonError::into_inner));
        self.news.notify_one();
        changed
    }

    /// The next change, and whether there will be no more. `None` after the last.
    fn next(&self) -> Option<(Line, bool)> {
        let mut lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        loop {
            let has_ended = lines.has_ended;
            match lines.pop() {
                Some(line) => return Some((line, has_ended)),
                None if has_ended => return None,
                None => lines = self.news.wait(lines).unwrap_or_else(PoisonError::into_inner),
            }
        }
    }
}

impl OnAlarm {
    pub(super) fn start(command: String) -> anyhow::Result<Self> {
        let waiting = Arc::new(Waiting::default());
        let taken = Arc::clone(&waiting);
        let thread = std::thread::Builder::new()
            .name("joulebus-on-alarm".to_owned())
            .spawn(move || run_all(&command, &taken))
            .context("cannot start a thread for --on-alarm")?;
        Ok(Self { waiting, thread: Some(thread), missed: 0 })
    }

    /// Hands a change to the command, unless too many are waiting.
    pub(super) fn run(&mut self, line: &Line) {
        if !self.waiting.change(|lines| lines.push(line)) {
            self.missed += 1;
            if self.missed.is_power_of_two() {
                let missed = self.missed;
                log_line(&format!(
                    "--on-alarm is too slow: it did not run for {missed} changes so far"
                ));
            }
        }
    }

    /// Runs the command for waiting changes, for as long as one command may take. Returns how many
    /// changes it did not run for, or failed for.
    pub(super) fn finish(mut self) -> u64 {
        self.waiting.change(|lines| lines.has_ended = true);
        let failed = self.thread.take().map_or(Ok(0), JoinHandle::join);
        self.missed + failed.unwrap_or(1)
    }
}

/// Runs the command for every change until the end. Returns how many failed.
fn run_all(command: &str, waiting: &Waiting) -> u64 {
    let mut failed = 0;
    let (mut last_failure, mut end_by) = (None, None);
    while let Some((line, has_ended)) = waiting.next() {
        if has_ended {
            let by = *end_by.get_or_insert_with(|| Instant::now() + TIMEOUT);
            if Instant::now() > by {
                failed += 1;
                continue;
            }
        }
        match run_once(command, &line, TIMEOUT) {
            Ok(()) => last_failure = None,
            Err(why) => {
                failed += 1;
                // A command that cannot be run would report that for every change.
                if last_failure.as_ref() != Some(&why) {
                    log_line(&format!("--on-alarm: {why}"));
                }
                last_failure = Some(why);
            }
        }
    }
    failed
}

fn run_once(command: &str, line: &Line, most: Duration) -> Result<(), String> {
    let shown = |value: Option<String>| value.unwrap_or_default();
    let mut child = Command::new("sh")
        .args(["-c", command])
        .env("JOULEBUS_FLEET", &line.0.fleet)
        .env("JOULEBUS_ROBOT", shown(line.0.robot.map(|robot| robot.to_string())))
        .env("JOULEBUS_ALARM", line.0.alarm)
        .env("JOULEBUS_LEVEL", line.0.level)
        .env("JOULEBUS_CHANGE", line.0.change)
        .env("JOULEBUS_STAMP_NS", line.0.stamp_ns.to_string())
        .env(
            "JOULEBUS_BY",
            shown(line.0.acknowledged.as_ref().map(|acknowledgement| acknowledgement.by.clone())),
        )
        .env("JOULEBUS_LASTED_S", shown(line.0.lasted_s.map(|s| s.to_string())))
        .stdin(Stdio::null())
        // Results of the verb stay alone on stdout.
        .stdout(Stdio::null())
        .process_group(0)
        .spawn()
        .map_err(|error| format!("cannot run sh: {error}"))?;
    let until = Instant::now() + most;
    loop {
        match child.try_wait() {
            Ok(Some(status)) => return taken(status),
            Ok(None) if Instant::now() < until => std::thread::sleep(POLL_INTERVAL),
            Ok(None) => {
                kill(&mut child);
                return Err(format!("killed after {} s", most.as_secs_f64()));
            }
            Err(error) => return Err(format!("cannot wait for it: {error}")),
        }
    }
}

fn taken(status: ExitStatus) -> Result<(), String> {
    match status.success() {
        true => Ok(()),
        false => Err(status.to_string()),
    }
}

/// Kills the command and what it has started.
fn kill(child: &mut Child) {
    if let Some(group) = Pid::from_raw(child.id().cast_signed()) {
        let _ = kill_process_group(group, Signal::KILL);
    }
    let _ = child.wait();
}

#[cfg(test)]
mod tests {
    use joulebus_board::{AcknowledgedRecord, AlarmRecord};

    use super::*;

    fn line() -> Line {
        Line(AlarmRecord {
            fleet: "lab".to_owned(),
            stamp_ns: 1_700_000_000_123_000_000,
            robot: Some(7),
            alarm: "BiasHigh",
            level: "warn",
            change: "cleared",
            lasted_s: Some(2.5),
            acknowledged: Some(AcknowledgedRecord { by: "ann".to_owned(), at_unix_ns: 1 }),
            card: None,
        })
    }

    #[test]
    fn a_command_has_the_change_in_its_environment_and_its_failure_is_reported() {
        let long = Duration::from_secs(60);
        let all = "$JOULEBUS_FLEET $JOULEBUS_ROBOT $JOULEBUS_ALARM $JOULEBUS_LEVEL $JOULEBUS_CHANGE \
                   $JOULEBUS_STAMP_NS $JOULEBUS_LASTED_S $JOULEBUS_BY";
        let expected = "lab 7 BiasHigh warn cleared 1700000000123000000 2.5 ann";
        let compare = format!("test \"{all}\" = '{expected}'");
        assert_eq!(run_once(&compare, &line(), long), Ok(()));
        let mut of_worker = line();
        (of_worker.0.robot, of_worker.0.lasted_s) = (None, None);
        let empty = "test \"$JOULEBUS_ROBOT.$JOULEBUS_LASTED_S\" = .";
        assert_eq!(run_once(empty, &of_worker, long), Ok(()));
        let failed = run_once("exit 3", &line(), long).unwrap_err();
        assert!(failed.contains('3'), "{failed}");
    }

    #[test]
    fn acknowledgements_wait_until_no_other_change_does_and_take_no_room_of_theirs() {
        let mut lines = Lines::default();
        let of = |change| Line(AlarmRecord { change, ..line().0 });
        for _ in 0..MAX_WAITING {
            assert!(lines.push(&of("acknowledged")));
        }
        assert!(!lines.push(&of("acknowledged")));
        assert!(lines.push(&of("raised")) && lines.push(&of("cleared")));
        let next: Vec<_> = (0..3).filter_map(|_| lines.pop()).map(|line| line.0.change).collect();
        assert_eq!(next, ["raised", "cleared", "acknowledged"]);
        assert_eq!(lines.acknowledgements.len(), MAX_WAITING - 1);
    }

    #[test]
    fn a_command_that_does_not_end_is_killed_with_what_it_started() {
        let folder = tempfile::tempdir().unwrap();
        let pid = folder.path().join("pid");
        let command = format!("sleep 1000 & echo $! > {}; wait", pid.display());
        let killed = run_once(&command, &line(), Duration::from_secs(2)).unwrap_err();
        assert_eq!(killed, "killed after 2 s");
        let pid = std::fs::read_to_string(pid).unwrap();
        let status = std::path::Path::new("/proc").join(pid.trim()).join("stat");
        let ended = || match std::fs::read_to_string(&status) {
            Ok(text) => text.contains(") Z "),
            Err(_) => true,
        };
        while !ended() {
            std::thread::sleep(POLL_INTERVAL);
        }
    }

    #[test]
    fn of_more_changes_than_may_wait_the_others_are_counted() {
        let mut command = OnAlarm::start("sleep 11".to_owned()).unwrap();
        // One is taken by the command at some time, the others wait.
        for _ in 0..MAX_WAITING + 11 {
            command.run(&line());
        }
        assert!((10..=11).contains(&command.missed), "{}", command.missed);
        command.waiting.change(|lines| lines.has_ended = true);
    }
}
