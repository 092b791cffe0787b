//! Commands that have less than a test: system calls, capabilities, memory.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};

/// The command, as `tools/docker_calls.py` runs it: with the system calls and capabilities that
/// Docker leaves a container. `None` where the kernel has no such filter, which is logged.
///
/// # Panics
/// There is no filter, although `CI=true`.
pub fn as_in_docker(command: &Command) -> Option<Command> {
    static WORKS: OnceLock<bool> = OnceLock::new();
    let launcher = || {
        let python = std::env::var("JOULEBUS_PYTHON").unwrap_or_else(|_| "python3".to_owned());
        let mut command = Command::new(python);
        command.arg(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tools/docker_calls.py"));
        command
    };
    let works = *WORKS.get_or_init(|| {
        let done = launcher().arg("true").status().is_ok_and(|status| status.success());
        assert!(done || std::env::var("CI").as_deref() != Ok("true"), "no filter of system calls");
        println!("{}", if done { "as in Docker" } else { "skipped: no filter of system calls" });
        done
    });
    works.then(|| within(launcher(), command))
}

/// `around`, with the other command as its last arguments.
fn within(mut around: Command, command: &Command) -> Command {
    around.arg(command.get_program()).args(command.get_args());
    for (name, value) in command.get_envs() {
        match value {
            Some(value) => around.env(name, value),
            None => around.env_remove(name),
        };
    }
    if let Some(folder) = command.get_current_dir() {
        around.current_dir(folder);
    }
    around
}

/// A memory cgroup. Where it has no memory left, the kernel kills its processes.
#[derive(Debug)]
pub struct MemoryGroup(PathBuf);

impl MemoryGroup {
    /// A group whose processes may have `bytes`. `None` where none can be made, which is logged.
    pub fn new(bytes: u64) -> Option<Self> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let name = format!("joulebus-{}-{number}", std::process::id());
        let root = Path::new("/sys/fs/cgroup");
        let is_first = root.join("memory").is_dir();
        let (parent, limit) = match is_first {
            true => (root.join("memory"), "memory.limit_in_bytes"),
            false => (root.to_owned(), "memory.max"),
        };
        let made = (|| {
            if !is_first {
                fs::write(parent.join("cgroup.subtree_control"), "+memory")?;
            }
            let group = parent.join(name);
            fs::create_dir(&group)?;
            let group = Self(group);
            fs::write(group.0.join(limit), bytes.to_string())?;
            Ok(group)
        })();
        made.inspect_err(|error: &std::io::Error| println!("skipped: no memory cgroup: {error}"))
            .ok()
    }

    /// The command in this group, and the first that the kernel kills there.
    pub fn first_to_die(&self, command: &Command) -> Command {
        self.inside("echo 1000 >/proc/self/oom_score_adj", command)
    }

    /// The command in this group.
    pub fn within(&self, command: &Command) -> Command {
        self.inside("true", command)
    }

    fn inside(&self, before: &str, command: &Command) -> Command {
        let mut shell = Command::new("sh");
        shell.arg("-c").arg(format!("echo $$ >\"$0\" && {before} && exec \"$@\""));
        shell.arg(self.0.join("cgroup.procs"));
        within(shell, command)
    }

    /// Takes memory until the kernel has killed everything in this group.
    ///
    /// # Panics
    /// The kernel has killed nothing.
    pub fn exhaust(&self) {
        let mut endless = Command::new("tail");
        endless.arg("/dev/zero");
        let ended = crate::Child::spawn("tail", self.within(&endless)).wait();
        assert_eq!(ended.signal(), Some(9), "{}", ended.errors());
    }
}

impl Drop for MemoryGroup {
    fn drop(&mut self) {
        // A process that has just ended may still be in it.
        crate::eventually("the group is empty", || fs::remove_dir(&self.0).is_ok());
    }
}
