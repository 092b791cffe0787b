//! Files that are opened, and files that are refused without blocking.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

use std::fs;
use std::io::Read as _;
use std::os::unix::fs::PermissionsExt as _;
use std::os::unix::fs::symlink;
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use rustix::fs::{CWD, FileType, Mode, OFlags, fcntl_getfl, mknodat};

fn fifo(path: &Path) {
    mknodat(CWD, path, FileType::Fifo, Mode::from_raw_mode(0o600), 0).unwrap();
}

#[test]
fn only_regular_files_are_opened_without_blocking() {
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name);
    fs::write(at("file"), "text").unwrap();
    fifo(&at("fifo"));
    let _socket = UnixListener::bind(at("socket")).unwrap();
    for (link, to) in [("link", "file"), ("link to a fifo", "fifo"), ("dangling", "none")] {
        symlink(at(to), at(link)).unwrap();
    }
    for (path, expected) in [
        (at("fifo"), "is a named pipe, allowed are regular files"),
        (at("link to a fifo"), "is a named pipe, allowed are regular files"),
        (at("socket"), "is a socket, allowed are regular files"),
        (at("."), "is a directory, allowed are regular files"),
        (PathBuf::from("/dev/zero"), "is a device, allowed are regular files"),
        (at("dangling"), "No such file or directory (os error 2)"),
    ] {
        let refusals = [
            joulebus_files::open(&path).map(drop),
            joulebus_files::read(&path, 100).map(drop),
            joulebus_files::read_to_string(&path, 100).map(drop),
            joulebus_files::look(&path).map(drop),
        ];
        for refused in refusals {
            assert_eq!(refused.unwrap_err().to_string(), expected, "{}", path.display());
        }
    }
    for name in ["file", "link"] {
        let mut file = joulebus_files::open(&at(name)).unwrap();
        assert!(!fcntl_getfl(&file).unwrap().contains(OFlags::NONBLOCK));
        let mut text = String::new();
        file.read_to_string(&mut text).unwrap();
        assert_eq!(text, "text");
    }
}

#[test]
fn files_beyond_the_limit_are_refused_with_both_lengths_before_reading() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("file");
    for (bytes, allowed) in [(0, 0), (1, 1), (10, 10), (10, 11)] {
        fs::write(&path, vec![b'x'; bytes]).unwrap();
        assert_eq!(joulebus_files::read(&path, allowed).unwrap().len(), bytes);
    }
    fs::write(&path, "0123456789").unwrap();
    let refused = joulebus_files::read(&path, 9).unwrap_err();
    assert_eq!(refused.to_string(), "has 10 bytes, allowed are 9");
    // A sparse file of a terabyte takes no memory.
    fs::File::create(&path).unwrap().set_len(1 << 40).unwrap();
    let refused = joulebus_files::read(&path, 9).unwrap_err();
    assert_eq!(refused.to_string(), "has 1099511627776 bytes, allowed are 9");
    // The length of these is unknown to the system.
    let refused = joulebus_files::read(Path::new("/proc/self/status"), 9).unwrap_err();
    assert_eq!(refused.to_string(), "has 10 bytes, allowed are 9");
    fs::write(&path, b"\xff").unwrap();
    let refused = joulebus_files::read_to_string(&path, 9).unwrap_err();
    assert_eq!(refused.kind(), std::io::ErrorKind::InvalidData);
}

#[test]
fn only_the_first_line_of_a_file_of_its_owner_alone_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("password");
    fs::write(&path, "hush\nmore\n").unwrap();
    for (mode, is_read) in [(0o600, true), (0o400, true), (0o640, false), (0o604, false)] {
        fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
        assert_eq!(
            joulebus_files::read_secret_line(&path).ok().as_deref() == Some("hush"),
            is_read
        );
    }
    fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
    fs::write(&path, "\n").unwrap();
    assert!(joulebus_files::read_secret_line(&path).is_err());
    assert!(joulebus_files::read_secret_line(folder.path()).is_err());
}

#[test]
fn a_secret_is_what_was_checked_although_its_path_leads_elsewhere_meanwhile() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for (name, mode) in [("secret", 0o600), ("public", 0o644)] {
        fs::write(at(name), name).unwrap();
        fs::set_permissions(at(name), fs::Permissions::from_mode(mode)).unwrap();
    }
    symlink(at("secret"), at("path")).unwrap();
    let is_over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            for name in ["public", "secret"].iter().cycle() {
                symlink(at(name), at("next")).unwrap();
                fs::rename(at("next"), at("path")).unwrap();
                if is_over.load(Ordering::Relaxed) {
                    break;
                }
            }
        });
        let read: Vec<_> =
            (0..20_000).map(|_| joulebus_files::read_secret_line(&at("path"))).collect();
        is_over.store(true, Ordering::Relaxed);
        assert!(read.iter().flatten().all(|text| text == "secret"));
    });
}
