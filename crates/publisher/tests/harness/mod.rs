//! Real processes for tests: the test binary starts itself as members of a fleet. Members and
//! tests talk in lines.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on ends")]
#![allow(
    unreachable_pub,
    dead_code,
    reason = "a module of test binaries, which export nothing and use a part each"
)]

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use joulebus_bus::Domain;
use joulebus_config::Config;
use rustix::process::{Pid, Signal, WaitOptions, kill_process, waitpid};

/// Marks what members say among what the test runner prints.
const MARK: &str = "@ ";
const ROLE: &str = "JOULEBUS_TEST_ROLE";
const CONFIG: &str = "JOULEBUS_TEST_CONFIG";
/// A member that says nothing for so long hangs.
const PATIENCE: Duration = Duration::from_secs(180);
static PLACES: AtomicU32 = AtomicU32::new(0);

/// The fleet of one test, removed with it.
pub struct Place {
    config: PathBuf,
    domain: Domain,
}

impl Place {
    pub fn new() -> Self {
        let number = PLACES.fetch_add(1, Ordering::Relaxed);
        let name = format!("joulebus-test-{}-{number}", std::process::id());
        let root = format!("/dev/shm/{name}");
        let config = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}.toml"));
        let text = format!(
            r#"
            [fleet]
            name = "test"
            capacity = 64
            [domain]
            root = "{root}"
            prefix = "jbt_"
            [intake]
            max_sources = 3
            [readers]
            max_planners = 3
            [[platform]]
            file = "builtin:rover"
            robots = ["0-63"]
            "#
        );
        fs::write(&config, text).unwrap();
        let domain = Config::load(&config).unwrap().domain().unwrap();
        Self { config, domain }
    }

    pub fn config(&self) -> &Path {
        &self.config
    }

    /// Starts a member in a process of its own; it runs the function that the test binary's
    /// `member` names so.
    pub fn start(&self, role: &str) -> Member {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "member", "--nocapture", "--test-threads=1"])
            .env(ROLE, role)
            .env(CONFIG, &self.config)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let (send, lines) = channel();
        let output = BufReader::new(child.stdout.take().unwrap());
        std::thread::spawn(move || {
            for line in output.lines().map_while(Result::ok) {
                // The runner may have begun the line.
                if let Some(at) = line.find(MARK) {
                    let _ = send.send(line[at + MARK.len()..].to_owned());
                }
            }
        });
        let role = role.to_owned();
        Member { child, lines, role }
    }

    pub fn assert_nothing_left(&self) {
        assert_eq!(self.objects(), Vec::<PathBuf>::new());
        assert!(!self.domain.root().exists());
    }

    fn objects(&self) -> Vec<PathBuf> {
        let entries = fs::read_dir("/dev/shm").unwrap().flatten();
        entries
            .filter(|entry| {
                let name = entry.file_name();
                name.to_string_lossy().starts_with(self.domain.shm_prefix())
            })
            .map(|entry| entry.path())
            .collect()
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        for object in self.objects() {
            let _ = fs::remove_file(object);
        }
        let _ = fs::remove_dir_all(self.domain.root());
        let _ = fs::remove_file(&self.config);
    }
}

/// A member in a process of its own.
pub struct Member {
    child: Child,
    lines: Receiver<String>,
    role: String,
}

impl Member {
    pub fn tell(&mut self, line: &str) {
        let input = self.child.stdin.as_mut().unwrap();
        // It may have been killed already: then the answer is missing, which is noticed.
        let _ = writeln!(input, "{line}");
    }

    pub fn hear(&mut self) -> String {
        match self.lines.recv_timeout(PATIENCE) {
            Ok(line) => line,
            Err(error) => panic!("{}: {error}", self.role),
        }
    }

    pub fn ask(&mut self, line: &str) -> String {
        self.tell(line);
        self.hear()
    }

    /// Stops it; it has stopped when this returns.
    pub fn stop(&self) {
        kill_process(self.pid(), Signal::STOP).unwrap();
        let stopped = waitpid(Some(self.pid()), WaitOptions::UNTRACED).unwrap();
        assert!(stopped.unwrap().1.stopped());
    }

    /// Lets it go on.
    pub fn go_on(&self) {
        kill_process(self.pid(), Signal::CONT).unwrap();
    }

    fn pid(&self) -> Pid {
        Pid::from_raw(self.child.id().cast_signed()).unwrap()
    }

    pub fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// Ends its input, and waits until it has ended, without a failure.
    pub fn finish(mut self) {
        drop(self.child.stdin.take());
        assert!(self.child.wait().unwrap().success(), "{}", self.role);
    }
}

impl Drop for Member {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Runs `member` with its role and the config's path, if this process was started as one.
pub fn run_member(member: impl FnOnce(&str, &Path)) {
    if let (Ok(role), Some(config)) = (std::env::var(ROLE), std::env::var_os(CONFIG)) {
        member(&role, Path::new(&config));
    }
}

/// As a member: says a line to the test.
pub fn say(line: impl std::fmt::Display) {
    println!("{MARK}{line}");
}

/// As a member: the next line of the test; none at the end.
pub fn told() -> Option<String> {
    std::io::stdin().lines().next().map(Result::unwrap)
}
