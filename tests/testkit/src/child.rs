//! Processes: started, signalled, always waited for. Every wait has the timeout [`PATIENCE`].

use std::ffi::OsStr;
use std::io::{BufRead as _, BufReader, Read, Write as _};
use std::os::unix::process::ExitStatusExt as _;
use std::path::{Path, PathBuf};
use std::process::{ChildStdin, Command, ExitStatus, Stdio};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};

/// Timeout of every wait. Far beyond the delays of a busy machine: only a defect reaches it.
pub const PATIENCE: Duration = Duration::from_secs(180);

/// Waits until `condition` holds.
pub fn eventually(what: &str, mut condition: impl FnMut() -> bool) {
    let begin = Instant::now();
    while !condition() {
        assert!(begin.elapsed() < PATIENCE, "timeout of {PATIENCE:?}: {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Remains of a fleet: its objects in shared memory (`prefix`), the folder `root`, and drafts of
/// it.
pub fn left_behind(prefix: &str, root: &Path) -> Vec<PathBuf> {
    let draft = format!(".{}.", root.file_name().unwrap_or_default().display());
    let beginning = |begin: &str, folder: &Path| -> Vec<PathBuf> {
        let all = std::fs::read_dir(folder).into_iter().flatten().flatten();
        let named = all.filter(|entry| entry.file_name().to_string_lossy().starts_with(begin));
        named.map(|entry| entry.path()).collect()
    };
    let mut left = beginning(prefix, Path::new("/dev/shm"));
    left.extend(root.parent().into_iter().flat_map(|folder| beginning(&draft, folder)));
    left.extend(root.exists().then(|| root.to_owned()));
    left
}

/// Removes a file or a folder, as others may do at the same time. They may also create files in the
/// folder between its listing and its removal.
pub fn remove(path: &Path) {
    eventually(&format!("{} is removed", path.display()), || {
        let removed = std::fs::remove_file(path).or_else(|_| std::fs::remove_dir_all(path));
        removed.is_ok() || !path.exists()
    });
}

/// The `joulebus` program beside `program`, another one of the same build. Built if it is missing.
pub fn joulebus_beside(program: &str) -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| beside(program, "joulebus"))
}

/// The program `joulebus-lab` beside `program`, which `joulebus` runs for the verbs on recordings
/// and models; built as [`joulebus_beside`] is.
pub fn lab_beside(program: &str) -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| beside(program, "joulebus-lab"))
}

/// The program `joulebus-link` beside `program`, which `joulebus bridge` runs for ROS 2 over zenoh;
/// built as [`joulebus_beside`] is.
pub fn link_beside(program: &str) -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| beside(program, "joulebus-link"))
}

/// The example `name` of a package, of the same build as `program`. Built if it is missing.
pub fn example_beside(program: &Path, package: &str, name: &str) -> PathBuf {
    let found = program.with_file_name("examples").join(name);
    built(program, &found, ["--package", package, "--example", name]);
    found
}

fn beside(program: &str, name: &str) -> PathBuf {
    let found = Path::new(program).with_file_name(name);
    built(Path::new(program), &found, ["--package", name, "--bin", name]);
    found
}

fn built(program: &Path, file: &Path, target: [&str; 4]) {
    if file.exists() {
        return;
    }
    let mut build = Command::new(env!("CARGO"));
    build.args(["build", "--quiet", "--locked"]).args(target);
    // The profile of `program` is its folder's name, but for `dev`.
    let profile = program.parent().and_then(Path::file_name);
    if let Some(profile) = profile.filter(|profile| *profile != "debug") {
        build.arg("--profile").arg(profile);
    }
    assert!(build.status().is_ok_and(|status| status.success()), "{build:?}");
}

/// Runs a program until it exits, without additional log output.
pub fn run<A: AsRef<OsStr>>(program: &str, arguments: impl IntoIterator<Item = A>) -> Ended {
    let mut command = Command::new(program);
    command.args(arguments).env_remove("JOULEBUS_LOG");
    Child::spawn(program, command).wait()
}

/// A process. Dropping it ends it as [`Child::at_drop`] requests, else kills it, and waits for it.
/// If the test fails, its output is printed.
#[derive(Debug)]
pub struct Child {
    name: String,
    process: std::process::Child,
    stdin: Option<ChildStdin>,
    stdout: Output,
    stderr: Output,
    ended: Option<ExitStatus>,
    at_drop: Option<fn(&mut Self) -> Ended>,
    started: Instant,
    /// Lines of stderr already consumed by a wait.
    lines_read: usize,
}

/// Exit status and complete output of a process.
#[derive(Debug, Clone)]
pub struct Ended {
    /// Exit code or signal.
    pub status: ExitStatus,
    pub stdout: Vec<String>,
    pub stderr: Vec<String>,
}

impl Ended {
    /// Exit code; none if killed by a signal.
    pub fn code(&self) -> Option<i32> {
        self.status.code()
    }

    /// Exit code of a process that was not killed by a signal.
    ///
    /// # Panics
    /// The process was killed by a signal.
    pub fn exit_code(&self) -> i32 {
        self.code().unwrap_or_else(|| panic!("killed: {self:?}"))
    }

    /// Checks the exit code.
    ///
    /// # Panics
    /// The exit code is another one.
    #[track_caller]
    pub fn exits(self, code: i32) -> Self {
        assert_eq!(self.exit_code(), code, "{}", self.errors());
        self
    }

    /// The signal that killed it.
    pub fn signal(&self) -> Option<i32> {
        self.status.signal()
    }

    pub fn errors(&self) -> String {
        self.stderr.join("\n")
    }

    pub fn text(&self) -> String {
        self.stdout.join("\n")
    }

    /// stdout parsed as one JSON value.
    pub fn json(&self) -> serde_json::Value {
        let text = self.text();
        serde_json::from_str(&text).unwrap_or_else(|error| panic!("{error} in {text:?}"))
    }
}

impl Child {
    /// Starts a program; `name` is used in messages.
    pub fn spawn(name: &str, command: Command) -> Self {
        Self::spawn_to(name, command, Stdio::piped())
    }

    /// Same as [`Child::spawn`], of a program whose stdout would fill the memory of the test in
    /// hours.
    pub fn spawn_unread(name: &str, command: Command) -> Self {
        Self::spawn_to(name, command, Stdio::null())
    }

    fn spawn_to(name: &str, mut command: Command, stdout: Stdio) -> Self {
        let started = Instant::now();
        let mut process = command
            .stdin(Stdio::piped())
            .stdout(stdout)
            .stderr(Stdio::piped())
            .spawn()
            .unwrap_or_else(|error| panic!("cannot start {command:?}: {error}"));
        Self {
            name: name.to_owned(),
            stdin: process.stdin.take(),
            stdout: Output::read(process.stdout.take()),
            stderr: Output::read(process.stderr.take()),
            process,
            ended: None,
            at_drop: None,
            started,
            lines_read: 0,
        }
    }

    /// From now on it is ended so when it is dropped, unless the test has waited for its exit.
    #[must_use]
    pub fn at_drop(mut self, end: fn(&mut Self) -> Ended) -> Self {
        self.at_drop = Some(end);
        self
    }

    pub fn pid(&self) -> u32 {
        self.process.id()
    }

    pub const fn started(&self) -> Instant {
        self.started
    }

    /// Sends a signal; ignored if the process has exited.
    pub fn signal(&mut self, signal: Signal) {
        if self.is_running()
            && let Some(pid) = Pid::from_raw(self.process.id().cast_signed())
        {
            // It may exit in between: until it is waited for, its pid is not reused.
            let _ = kill_process(pid, signal);
        }
    }

    /// True if it has not exited.
    pub fn is_running(&mut self) -> bool {
        if self.ended.is_none() {
            self.ended = self.process.try_wait().unwrap_or_default();
        }
        self.ended.is_none()
    }

    /// Sends SIGKILL and waits for the exit.
    pub fn kill(&mut self) -> Ended {
        self.signal(Signal::KILL);
        self.wait()
    }

    /// Sends SIGTERM and waits for the exit with any status.
    pub fn end(&mut self) -> Ended {
        self.signal(Signal::TERM);
        self.wait()
    }

    /// Sends SIGTERM and waits for the exit; it must succeed.
    pub fn stop(&mut self) -> Ended {
        let ended = self.end();
        assert_eq!(ended.code(), Some(0), "{}: {ended:?}", self.name);
        ended
    }

    /// Closes its stdin and waits for the exit with any status.
    pub fn close(&mut self) -> Ended {
        self.stdin = None;
        self.wait()
    }

    /// Closes its stdin and waits for the exit; it must succeed.
    pub fn finish(&mut self) -> Ended {
        let ended = self.close();
        assert_eq!(ended.code(), Some(0), "{}: {ended:?}", self.name);
        ended
    }

    /// Waits for the exit.
    pub fn wait(&mut self) -> Ended {
        self.at_drop = None;
        let begin = Instant::now();
        while self.is_running() {
            assert!(begin.elapsed() < PATIENCE, "{} does not exit: {}", self.name, self.tail());
            std::thread::sleep(Duration::from_millis(1));
        }
        Ended {
            status: self.ended.unwrap_or_default(),
            stdout: self.stdout.whole(),
            stderr: self.stderr.whole(),
        }
    }

    /// Waits until a line on stderr contains `part` and returns the line. Later calls continue
    /// after it.
    pub fn wait_for_line(&mut self, part: &str) -> String {
        match self.try_wait_for_line(part, PATIENCE) {
            Some(line) => line,
            None => panic!("{} has not printed {part:?}: {}", self.name, self.tail()),
        }
    }

    /// Like [`Self::wait_for_line`]; `None` if it exits or the timeout passes first.
    pub fn try_wait_for_line(&mut self, part: &str, within: Duration) -> Option<String> {
        let begin = Instant::now();
        loop {
            let left = within.saturating_sub(begin.elapsed());
            let lines = self.stderr.after(self.lines_read, left);
            let found = lines.iter().position(|line| line.contains(part));
            self.lines_read += found.map_or(lines.len(), |at| at + 1);
            match found {
                Some(at) => return lines.into_iter().nth(at),
                None if lines.is_empty() => return None,
                None => {}
            }
        }
    }

    /// Its output on stderr so far.
    pub fn errors(&self) -> String {
        self.stderr.lock().lines.join("\n")
    }

    /// Writes a line to its stdin; ignored if the process has exited.
    pub fn send_line(&mut self, line: &str) {
        if let Some(stdin) = &mut self.stdin {
            let _ = writeln!(stdin, "{line}");
        }
    }

    /// Lines of stdout from `from` on; waits for at least one. Empty at the end of the output or
    /// after the timeout.
    pub fn lines(&self, from: usize, within: Duration) -> Vec<String> {
        self.stdout.after(from, within)
    }

    /// The last lines of its output.
    pub fn tail(&self) -> String {
        let mut text = format!("what {} (pid {}) wrote:", self.name, self.pid());
        for output in [&self.stdout, &self.stderr] {
            let lines = output.lock().lines.clone();
            for line in lines.iter().rev().take(20).rev() {
                let shown: String = line.chars().take(400).collect();
                text.push_str("\n  ");
                text.push_str(&shown);
            }
        }
        text
    }
}

impl Drop for Child {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("{}", self.tail());
        } else if let Some(end) = self.at_drop {
            self.signal(Signal::CONT);
            end(self);
        }
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Lines read by a thread.
#[derive(Debug)]
struct Output {
    shared: Arc<(Mutex<Lines>, Condvar)>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Lines {
    lines: Vec<String>,
    ended: bool,
}

impl Output {
    fn read(source: Option<impl Read + Send + 'static>) -> Self {
        let shared = Arc::new((Mutex::new(Lines::default()), Condvar::new()));
        let inside = Arc::clone(&shared);
        let thread = source.map(|source| {
            std::thread::spawn(move || {
                let mut source = BufReader::new(source);
                let mut line = Vec::new();
                // Bytes, not text: the last line of a killed process may be truncated anywhere.
                while source.read_until(b'\n', &mut line).is_ok_and(|length| length > 0) {
                    let text = String::from_utf8_lossy(&line).trim_end_matches('\n').to_owned();
                    line.clear();
                    lock(&inside.0).lines.push(text);
                    inside.1.notify_all();
                }
                lock(&inside.0).ended = true;
                inside.1.notify_all();
            })
        });
        Self { shared, thread }
    }

    fn lock(&self) -> MutexGuard<'_, Lines> {
        lock(&self.shared.0)
    }

    fn after(&self, from: usize, within: Duration) -> Vec<String> {
        let nothing_new = |lines: &mut Lines| lines.lines.len() <= from && !lines.ended;
        let (lines, _) = self
            .shared
            .1
            .wait_timeout_while(self.lock(), within, nothing_new)
            .unwrap_or_else(PoisonError::into_inner);
        lines.lines.get(from..).unwrap_or_default().to_vec()
    }

    /// All lines, once the process has exited.
    fn whole(&mut self) -> Vec<String> {
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        self.lock().lines.clone()
    }
}

fn lock(lines: &Mutex<Lines>) -> MutexGuard<'_, Lines> {
    lines.lock().unwrap_or_else(PoisonError::into_inner)
}
