//! A fleet of one test, and its members in processes of their own.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use crate::{Member, left_behind};

const ROLE: &str = "JOULEBUS_TEST_ROLE";
const CONFIG: &str = "JOULEBUS_TEST_CONFIG";
static FLEETS: AtomicU32 = AtomicU32::new(0);

/// The fleet of one test, removed when dropped. What its members have left then fails the test.
#[derive(Debug)]
pub struct TestFleet {
    config: PathBuf,
    root: PathBuf,
    prefix: String,
}

impl TestFleet {
    /// A fleet of at most 64 rovers that nobody has joined.
    ///
    /// # Panics
    /// The fleet's config cannot be written.
    pub fn new() -> Self {
        let number = FLEETS.fetch_add(1, Ordering::Relaxed);
        let (name, prefix) = names(std::process::id(), number);
        let root = Path::new("/dev/shm").join(&name);
        let config = std::env::temp_dir().join(format!("{name}.toml"));
        let text = format!(
            r#"
            [fleet]
            name = "test"
            capacity = 64
            [domain]
            root = "{}"
            prefix = "{prefix}"
            [intake]
            max_sources = 3
            [readers]
            max_planners = 3
            [[platform]]
            file = "builtin:rover"
            robots = ["0-63"]
            "#,
            root.display()
        );
        fs::write(&config, text).expect("a file for temporary use");
        Self { config, root, prefix }
    }

    pub fn config(&self) -> &Path {
        &self.config
    }

    /// Starts a member in a separate process; it runs the function that the test binary's `member`
    /// selects by name.
    pub fn start(&self, role: &str) -> Member {
        let mut command = Member::command();
        command.env(ROLE, role).env(CONFIG, &self.config);
        Member::spawn_to_finish(role, command)
    }
}

impl Default for TestFleet {
    fn default() -> Self {
        Self::new()
    }
}

impl Drop for TestFleet {
    fn drop(&mut self) {
        let left = left_behind(&self.prefix, &self.root);
        for object in &left {
            let _ = fs::remove_file(object);
        }
        let _ = fs::remove_dir_all(&self.root);
        let _ = fs::remove_file(&self.config);
        assert!(left.is_empty() || std::thread::panicking(), "left behind: {left:?}");
    }
}

/// A place's name, and its objects' prefix: at most eight of a-z, 0-9 and `_`, unique on the host.
fn names(pid: u32, number: u32) -> (String, String) {
    let name = format!("joulebus-test-{pid}-{number}");
    // A pid has at most 22 bits: five of these digits.
    let (mut rest, mut prefix) =
        (u64::from(pid) * 36 * 36 + u64::from(number % (36 * 36)), String::from("j"));
    for _ in 0..7 {
        let digit = (rest % 36) as u32;
        prefix.extend(char::from_digit(digit, 36));
        rest /= 36;
    }
    (name, prefix)
}

/// Runs `member` with its role and the config's path, if this process was started as one.
pub fn run_member(member: impl FnOnce(&str, &Path)) {
    if let (Ok(role), Some(config)) = (std::env::var(ROLE), std::env::var_os(CONFIG)) {
        member(&role, Path::new(&config));
    }
}

/// In a member: the next line from the test; `None` at the end.
///
/// # Panics
/// stdin cannot be read.
pub fn next_order() -> Option<String> {
    let line = std::io::stdin().lines().next();
    line.map(|line| line.expect("the test writes UTF-8"))
}
