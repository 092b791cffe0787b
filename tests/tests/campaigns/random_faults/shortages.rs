//! Less of a resource than a process needs: a disk, memory, a limit.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use joulebus_tests::Child;
use rustix::process::{Pid, Resource, Rlimit, prlimit};

const DISK_BYTES: u64 = 4 << 20;

/// Sets a limit of process `pid` for a while.
pub(crate) fn limited(pid: u32, resource: Resource, most: u64, time: Duration) {
    let pid = Pid::from_raw(pid.cast_signed());
    let before = rustix::process::getrlimit(resource);
    let limit = Rlimit { current: Some(most), ..before };
    // It may have ended.
    let _ = prlimit(pid, resource, limit);
    std::thread::sleep(time);
    let _ = prlimit(pid, resource, before);
}

/// A small file system of its own. Only root can mount one.
pub(crate) struct SmallDisk {
    folder: PathBuf,
}

impl SmallDisk {
    /// None, with a line that reports it, where nothing can be mounted.
    pub(crate) fn mount(folder: &Path) -> Option<Self> {
        fs::create_dir_all(folder).expect("a folder of the test");
        let mut command = Command::new("mount");
        let size = format!("size={DISK_BYTES},mode=755");
        command.args(["-t", "tmpfs", "-o", &size, "tmpfs"]).arg(folder);
        let is_mounted = Child::spawn("mount", command).wait().code() == Some(0);
        if !is_mounted {
            println!("skipped: a small disk, because nothing can be mounted");
        }
        is_mounted.then(|| Self { folder: folder.to_owned() })
    }

    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Fills the disk until so many bytes are left, give or take a page.
    pub(crate) fn leave(&self, bytes: u64) {
        let (file, full) = (self.folder.join("filling"), DISK_BYTES - bytes);
        // Captures may not take the rest either.
        let _ = fs::write(file, vec![0; full as usize]);
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let mut command = Command::new("umount");
        command.args(["-l"]).arg(&self.folder);
        let _ = Child::spawn("umount", command).wait();
    }
}

/// A control group whose processes are killed by the kernel when they need more memory than it has.
pub(crate) struct LittleMemory {
    folder: PathBuf,
}

static GROUPS: AtomicU32 = AtomicU32::new(0);

impl LittleMemory {
    /// None where control groups are not writable.
    pub(crate) fn create(max_bytes: u64) -> Option<Self> {
        let number = GROUPS.fetch_add(1, Ordering::Relaxed);
        let name = format!("joulebus-test-{}-{number}", std::process::id());
        // Version 1 has one hierarchy for memory, version 2 one for everything.
        let places =
            [("/sys/fs/cgroup/memory", "memory.limit_in_bytes"), ("/sys/fs/cgroup", "memory.max")];
        for (root, limit) in places {
            if !Path::new(root).join("cgroup.procs").exists() {
                continue;
            }
            let folder = Path::new(root).join(&name);
            if fs::create_dir(&folder).is_err() {
                continue;
            }
            let group = Self { folder };
            if fs::write(group.folder.join(limit), max_bytes.to_string()).is_ok() {
                return Some(group);
            }
        }
        println!("skipped: little memory, because control groups are not writable");
        None
    }

    /// The same command, started in the group.
    pub(crate) fn within(&self, command: &Command) -> Command {
        let mut inside = Command::new("sh");
        inside
            .args(["-c", "echo $$ > \"$0/cgroup.procs\" && exec \"$@\""])
            .arg(&self.folder)
            .arg(command.get_program())
            .args(command.get_args());
        for (name, value) in command.get_envs() {
            match value {
                Some(value) => inside.env(name, value),
                None => inside.env_remove(name),
            };
        }
        inside
    }
}

impl Drop for LittleMemory {
    fn drop(&mut self) {
        // A process that was killed leaves the group a moment later.
        for _ in 0..100 {
            if fs::remove_dir(&self.folder).is_ok() {
                return;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}
