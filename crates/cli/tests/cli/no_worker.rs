//! Verbs that look for a worker where there is none: each says so, and whose there is.

use std::fs;
use std::os::unix::fs::{PermissionsExt, chown};
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use joulebus_testkit::{Child, assert_contains};
use rustix::process::{Signal, geteuid};

use crate::captures::capture;
use crate::fleet::{Fleet, Program, at, is_built, joulebus, sees_all, stderr, stdout};

/// Uid of `nobody`.
const OTHER: u32 = 65_534;
/// A user and a group that no system has.
const MEMBER: u32 = 3_141_592;
const GROUP: u32 = 3_141_593;

/// Verbs that go on without a worker, until a signal. Words in capitals are files.
const WAITS: &[&str] = &[
    "alarms",
    "watch --plain",
    "watch --format json",
    "record -o RECORDED",
    "publish sim --robots 3",
    "publish trial TRIAL@0",
    "publish trial TRIAL@0 --loop --no-wait",
    "replay CAPTURE",
    "serve --http 127.0.0.1:0",
    "bridge BRIDGE",
];

/// Verbs that end with an error.
const ENDS: &[&str] = &[
    "alarms --acknowledge 1 NoData --by ann",
    "battery",
    "battery 1 --full --by ann",
    "ask --robot 1 --idle 10",
    "ask --robot 1 --idle 10 --through worker",
    "watch --once",
];

/// The command of a row with the config of `fleet`, whose domain lies below `root`.
fn command(fleet: &Fleet, root: &Path, row: &str) -> Command {
    let config = fleet.path("own.toml");
    write_config(fleet, &config, root);
    let file = |name: &str| match name {
        "RECORDED" => fleet.path("run.mcap"),
        "TRIAL@0" => at(&fleet.recording("a.csv", 30), "0"),
        "CAPTURE" => capture(fleet, 30).0,
        "BRIDGE" => {
            let path = fleet.path("bridge.toml");
            let text = "[robots]\nagv = 1\n[mqtt]\nbroker = \"127.0.0.1:1\"\n\
                        [[mqtt.read]]\ntopic = \"{robot}/power\"\nfields = { power = { at = \"\" } }\n";
            fs::write(&path, text).unwrap();
            path
        }
        word => PathBuf::from(word),
    };
    let mut command = joulebus(row.split_whitespace().map(file));
    command.arg("--config").arg(config);
    command
}

fn write_config(fleet: &Fleet, path: &Path, root: &Path) {
    let text = fs::read_to_string(fleet.config()).unwrap();
    let own = fleet.root().display().to_string();
    fs::write(path, text.replace(&own, &root.display().to_string())).unwrap();
}

/// Each row says `wanted`, in one line with the fleet.
fn each_says(folder: &Path, wanted: &[&str]) {
    let root = folder.join(format!("joulebus-{}", geteuid().as_raw()));
    for row in WAITS.iter().chain(ENDS).filter(|row| is_built(row)) {
        let fleet = Fleet::new();
        let mut program = Program::start(command(&fleet, &root, row));
        program.wait_for_stderr("no worker serves fleet cli");
        let ends = ENDS.contains(row);
        let ended = if ends { program.wait() } else { program.end(Signal::TERM) };
        let printed = stderr(&ended);
        let said = printed.lines().find(|line| line.contains("no worker serves fleet cli"));
        let said = said.unwrap_or_default();
        for part in wanted {
            assert!(said.contains(part), "{row}: {part:?} is not in {said:?}");
        }
        if ends {
            assert_eq!(ended.status.code(), Some(1), "{row}: {printed}");
        }
    }
}

#[test]
fn every_verb_that_looks_for_a_worker_says_that_none_is_seen() {
    let folder = tempfile::tempdir().unwrap();
    each_says(folder.path(), &["`joulebus run`", "`joulebus doctor`"]);
}

#[test]
fn every_verb_that_looks_for_a_worker_names_the_user_who_runs_one() {
    if !geteuid().is_root() {
        let why = "only root can start a worker as another user";
        assert!(std::env::var("CI").as_deref() != Ok("true"), "{why}");
        eprintln!("SKIPPED: {why}");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::set_permissions(folder.path(), PermissionsExt::from_mode(0o755)).unwrap();
    // In a process of its own: a child of another test would inherit the file that is written.
    let mut copy = Command::new("cp");
    copy.arg(env!("CARGO_BIN_EXE_joulebus")).arg(at("joulebus"));
    assert!(copy.status().unwrap().success());
    let theirs = at(&format!("joulebus-{OTHER}"));
    fs::create_dir(&theirs).unwrap();
    fs::set_permissions(&theirs, PermissionsExt::from_mode(0o700)).unwrap();
    chown(&theirs, Some(OTHER), Some(OTHER)).unwrap();
    let fleet = Fleet::new();
    let config = at("theirs.toml");
    write_config(&fleet, &config, &theirs);
    let mut run = Command::new(at("joulebus"));
    run.args(["run", "--config"]).arg(&config).current_dir("/");
    run.uid(OTHER).gid(OTHER).env_remove("JOULEBUS_LOG");
    let mut worker = Child::spawn("their worker", run);
    worker.wait_for_line("ready:");
    let (uid, pid) = (format!("uid {OTHER}"), format!("pid {}", worker.pid()));
    let root = theirs.display().to_string();
    each_says(
        folder.path(),
        &[&root, &uid, &pid, "su -s /bin/sh nobody -c", "`joulebus serve --socket"],
    );
    let own = at(&format!("joulebus-{}", geteuid().as_raw()));
    let alone = sees_all();
    let status = command(&Fleet::new(), &own, "status").output().unwrap();
    drop(alone);
    assert_contains(&stdout(&status), [root.as_str(), &uid, &pid, "su -s /bin/sh nobody"]);
    // The remedies: as that user, or by a socket for a group, which nobody else may enter.
    let verb = format!("{} status --config {}", at("joulebus").display(), config.display());
    let su = Command::new("su").args(["-s", "/bin/sh", "nobody", "-c", &verb]).output().unwrap();
    let theirs_seen = format!("worker {pid}");
    assert_contains(&stdout(&su), ["yours", theirs_seen.as_str()]);
    if is_built("serve") {
        let mut copy = Command::new("cp");
        let serve = Path::new(env!("CARGO_BIN_EXE_joulebus")).with_file_name("joulebus-serve");
        assert!(copy.arg(serve).arg(at("joulebus-serve")).status().unwrap().success());
        let sockets = at("sockets");
        fs::create_dir(&sockets).unwrap();
        chown(&sockets, Some(OTHER), Some(GROUP)).unwrap();
        fs::set_permissions(&sockets, PermissionsExt::from_mode(0o2750)).unwrap();
        let mut run = Command::new(at("joulebus"));
        run.args(["serve", "--socket"]).arg(sockets.join("s")).arg("--config").arg(&config);
        run.current_dir("/").uid(OTHER).gid(OTHER).env_remove("JOULEBUS_LOG");
        let mut serve = Child::spawn("their socket", run);
        serve.wait_for_line("/s");
        for (group, code) in [(GROUP, 0), (GROUP + 1, 7)] {
            let mut curl = Command::new("curl");
            curl.args(["-sS", "http://localhost/api/v1/fleet", "--unix-socket"]);
            let asked = curl.arg(sockets.join("s")).uid(MEMBER).gid(group).output().unwrap();
            assert_eq!(asked.status.code(), Some(code), "{group}: {}", stderr(&asked));
        }
        serve.signal(Signal::TERM);
        assert_eq!(serve.wait().code(), Some(0));
    }
    worker.signal(Signal::TERM);
    assert_eq!(worker.wait().code(), Some(0));
}
