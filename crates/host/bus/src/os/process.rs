//! Other processes.

use std::fs::File;
use std::io::{self, Read};
use std::os::unix::fs::MetadataExt;

use rustix::fs::{major, minor};
use rustix::io::Errno;
use rustix::process::{Pid, test_kill_process};

/// True if the process exists here. One of another container is not visible.
pub(crate) fn is_alive(pid: u32) -> bool {
    let pid = i32::try_from(pid).ok().and_then(Pid::from_raw);
    pid.is_some_and(|pid| !matches!(test_kill_process(pid), Err(Errno::SRCH)))
}

/// The processes that hold an exclusive `flock` of `file`, as reported by the kernel. None of
/// another container. On some file systems the kernel reports a device different from that in the
/// file's metadata: there only `expected` is considered.
pub(crate) fn lock_holders(file: &File, expected: Option<u32>) -> io::Result<Vec<u32>> {
    let found = file.metadata()?;
    let device = format!("{:02x}:{:02x}", major(found.dev()), minor(found.dev()));
    let inode = found.ino().to_string();
    let holder = |line: &str| {
        let mut words = line.split_ascii_whitespace().skip(1);
        let is_flock = words.next()? == "FLOCK";
        let is_exclusive = words.nth(1)? == "WRITE";
        let pid: u32 = words.next()?.parse().ok()?;
        let (there, number) = words.next()?.rsplit_once(':')?;
        let is_it = number == inode && (there == device || expected == Some(pid));
        (is_flock && is_exclusive && is_it && pid > 1 && is_alive(pid)).then_some(pid)
    };
    // Room for whole pages: between two reads the kernel may skip a lock while others are released.
    let mut locks = Vec::with_capacity(64 << 10);
    if let Ok(mut list) = File::open("/proc/locks") {
        let _ = list.read_to_end(&mut locks);
    }
    let locks = String::from_utf8_lossy(&locks);
    Ok(locks.lines().filter_map(holder).collect())
}
