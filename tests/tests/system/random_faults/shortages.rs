//! Less of a resource than a process needs: a disk, a limit.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
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
