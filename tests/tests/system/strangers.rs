//! Row 19: another user of the host can neither read, inject, nor squat.
//!
//! Requires the privilege to become another user; without it the test is skipped, and fails if
//! CI=true.

use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};

use joulebus_tests::{Arena, Child, Setup, figure, program, sample};

/// Uid of `nobody`.
const STRANGER: u32 = 65_534;

/// Copies of the programs that the other user can execute.
struct Programs(PathBuf);

impl Programs {
    /// `None` if this process cannot become another user.
    fn copy(arena: &Arena) -> Option<Self> {
        let name = arena.files().file_name()?.to_owned();
        let directory = std::env::temp_dir().join(name);
        std::fs::create_dir(&directory).expect("no other test has the name");
        let programs = Self(directory);
        std::fs::set_permissions(&programs.0, PermissionsExt::from_mode(0o755)).ok()?;
        for name in ["joulebus-probe", "joulebus-under-test"] {
            // In a separate process: a child forked by another test in the meantime would inherit
            // the open file, and a file open for writing cannot be executed (ETXTBSY).
            let copied = Command::new("cp").arg(program(name)).arg(&programs.0).status();
            assert!(copied.expect("cp").success(), "no room for {name}");
        }
        let works = programs
            .command("joulebus-under-test", &["--version"])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status();
        if works.as_ref().is_ok_and(ExitStatus::success) {
            return Some(programs);
        }
        assert_ne!(
            std::env::var("CI").as_deref(),
            Ok("true"),
            "cannot become another user: {works:?}"
        );
        println!("skipped: cannot become another user: {works:?}");
        None
    }

    fn command(&self, program: &str, arguments: &[&str]) -> Command {
        let mut command = as_stranger(&self.0.join(program));
        command.args(arguments);
        command
    }
}

impl Drop for Programs {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn as_stranger(program: &Path) -> Command {
    let mut command = Command::new(program);
    command.uid(STRANGER).gid(STRANGER).current_dir("/");
    command
}

/// Prints which of its arguments the other user can read or list, and write or remove.
const ATTEMPTS: &str = "for path; do \
    { head -c 1 \"$path\" || ls \"$path/\"; } >/dev/null 2>&1 && echo \"read $path\"; \
    { (: >>\"$path\") || touch \"$path/intruder\" || rm \"$path\" </dev/null; } 2>/dev/null \
        && echo \"changed $path\"; \
    done; true";

/// Runs a shell line as the other user; it must succeed.
fn stranger_does(line: &str) {
    let status = as_stranger(Path::new("/bin/sh")).args(["-c", line]).status().expect("a shell");
    assert!(status.success(), "{line}");
}

#[test]
fn row_19_another_user_can_neither_read_nor_inject_nor_clean_up() {
    let setup = Setup::default();
    let arena = Arena::new(&setup);
    let Some(programs) = Programs::copy(&arena) else {
        return;
    };
    let config = arena.config().display().to_string();
    let _worker = arena.worker();
    let mut planner = arena.planner();
    let mut source = arena.source("fleet");
    let _controller = arena.controller("controller", 20, 2, 30.0);
    planner.forecast("all are there", |frame| frame.robot(20).map(|_| ()));

    let before = arena.stale_files();
    assert!(before.len() > 10, "{before:?}");
    let mut intruder = as_stranger(Path::new("/bin/sh"));
    intruder.args(["-c", ATTEMPTS, "sh"]).args(&before);
    intruder.arg(arena.domain().directory()).arg(arena.domain().root());
    let ended = Child::spawn("intruder", intruder).wait();
    assert_eq!((ended.code(), ended.text()), (Some(0), String::new()), "{ended:?}");
    for arguments in [
        &["planner"][..],
        &["source", "fleet"],
        &["recorder"],
        &["controller", "fleet", "0", "4", "30"],
    ] {
        let mut arguments = arguments.to_vec();
        arguments.push(&config);
        let ended = Child::spawn("stranger", programs.command("joulebus-probe", &arguments)).wait();
        assert_eq!(ended.code(), Some(1), "{arguments:?}: {ended:?}");
        assert!(ended.errors().contains("belongs to uid"), "{arguments:?}: {ended:?}");
    }
    for arguments in [&["run"][..], &["doctor", "--fix"]] {
        let mut arguments = arguments.to_vec();
        arguments.extend(["--config", &config]);
        let ended =
            Child::spawn("stranger", programs.command("joulebus-under-test", &arguments)).wait();
        assert_eq!(ended.code(), Some(1), "{arguments:?}: {ended:?}");
    }
    assert!(before.iter().all(|path| path.exists()), "a stranger removed something");
    for seq in 0..10 {
        planner.play(&mut source, &[vec![sample(0, seq, setup.period_ns())]]);
    }
    figure(
        "row 19, leaks and injections",
        format_args!("0, of {} objects and directories", before.len()),
    );
}

#[test]
fn row_19_files_created_earlier_by_another_user_are_refused_with_the_owner() {
    let arena = Arena::new(&Setup::default());
    let Some(_programs) = Programs::copy(&arena) else {
        return;
    };
    let root = arena.domain().root().display().to_string();
    let object = format!("/dev/shm/{}squat", arena.domain().shm_prefix());
    let (uid, link) = (format!("uid {STRANGER}"), "symbolic link".to_owned());
    for (what, line, undo, shows) in [
        ("an open directory", format!("mkdir -m 777 {root}"), "rmdir", &uid),
        ("a private directory", format!("mkdir -m 700 {root}"), "rmdir", &uid),
        ("a file", format!("touch {root}"), "rm", &uid),
        ("a link", format!("ln -s /tmp {root}"), "rm", &link),
        ("an object in shared memory", format!("touch {object}"), "rm", &uid),
    ] {
        stranger_does(&line);
        let ended = arena.run(&["run"]);
        assert_eq!(ended.code(), Some(1), "{what}: {ended:?}");
        let named =
            ended.errors().contains(shows.as_str()) || ended.errors().contains("not a directory");
        assert!(named, "{what}: {}", ended.errors());
        let ended = Child::spawn("source", arena.probe(&["source", "fleet"])).wait();
        assert_eq!(ended.code(), Some(1), "{what}: {ended:?}");
        let doctor = arena.run(&["doctor"]);
        assert_eq!(doctor.code(), Some(1), "{what}: {doctor:?}");
        let place = if what.contains("object") { &object } else { &root };
        stranger_does(&format!("{undo} {place}"));
    }
    arena.worker().stop();
}
