//! Separate processes for tests: the test binary starts itself as members of a fleet. Members and
//! tests exchange lines.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]
#![allow(
    unreachable_pub,
    dead_code,
    reason = "a module of test binaries, each of which uses a part"
)]

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use joulebus_bus::Domain;
use joulebus_config::Config;
use joulebus_test_processes::Member;

const ROLE: &str = "JOULEBUS_TEST_ROLE";
const CONFIG: &str = "JOULEBUS_TEST_CONFIG";
static PLACES: AtomicU32 = AtomicU32::new(0);

/// The fleet of one test, removed when dropped.
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

    /// Starts a member in a separate process; it runs the function that the test binary's `member`
    /// selects by name.
    pub fn start(&self, role: &str) -> Member {
        let mut command = Member::command();
        command.env(ROLE, role).env(CONFIG, &self.config);
        Member::spawn(role, command)
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

/// Runs `member` with its role and the config's path, if this process was started as one.
pub fn run_member(member: impl FnOnce(&str, &Path)) {
    if let (Ok(role), Some(config)) = (std::env::var(ROLE), std::env::var_os(CONFIG)) {
        member(&role, Path::new(&config));
    }
}

/// In a member: the next line from the test; `None` at the end.
pub fn told() -> Option<String> {
    std::io::stdin().lines().next().map(Result::unwrap)
}
