//! Row 24: if shared memory is nearly full, processes that need more fail with an error that states
//! the numbers, and running ones are not affected. Never a signal.
//!
//! Each test has a separate shared memory in a mount namespace; without the privilege for it the
//! test is skipped, and fails if CI=true.

use std::fs;
use std::path::PathBuf;
use std::process::Command;

use joulebus_tests::{Arena, Child, Dice, Ended, PATIENCE, Planner, Setup, figure, program};
use tempfile::TempDir;

/// A separate `/dev/shm` with the arena's fleet.
struct OwnShm {
    _arena: Arena,
    holder: Child,
    _folder: TempDir,
    config: PathBuf,
    capture: PathBuf,
}

impl OwnShm {
    fn new(setup: &Setup) -> Option<Self> {
        let arena = Arena::new(setup);
        let mut command = Command::new("unshare");
        let script = "mount -t tmpfs -o size=1g tmpfs /dev/shm && echo mounted && exec sleep 3600";
        command.args(["-m", "sh", "-c", script]);
        let holder = Child::spawn("holder", command);
        if holder.lines(0, PATIENCE).is_empty() {
            assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "{}", holder.tail());
            println!("skipped: needs the right to mount");
            return None;
        }
        let folder = tempfile::tempdir().expect("a folder for temporary use");
        let config = folder.path().join("fleet.toml");
        fs::copy(arena.config(), &config).expect("there is room");
        let capture = folder.path().join("run.mcap");
        Some(Self { _arena: arena, holder, _folder: folder, config, capture })
    }

    fn inside(&self, program: &std::path::Path, arguments: &[&str]) -> Command {
        let mut command = Command::new("nsenter");
        let pid = self.holder.pid().to_string();
        command.args(["-m", "-t", &pid]).arg(program).args(arguments);
        command
    }

    fn joulebus(&self, arguments: &[&str]) -> Command {
        let mut command = self.inside(&program("joulebus-under-test"), arguments);
        command.arg("--config").arg(&self.config);
        command
    }

    fn probe(&self, arguments: &[&str]) -> Command {
        let mut command = self.inside(&program("joulebus-probe"), arguments);
        command.arg(&self.config);
        command
    }

    fn leave(&self, left: Left) {
        let path = format!("/proc/{}/root/dev/shm", self.holder.pid());
        let found = rustix::fs::statvfs(&path).expect("the holder lives");
        let options = match left {
            Left::Bytes(bytes) => {
                let used = (found.f_blocks - found.f_bfree) * found.f_frsize;
                // 0 would mean no limit.
                format!("remount,size={}", (used + bytes).max(4_096))
            }
            Left::Files(files) => {
                format!("remount,nr_inodes={}", found.f_files - found.f_ffree + files)
            }
        };
        let mut command = self.inside("mount".as_ref(), &["-o", &options]);
        let done = command.arg("/dev/shm").status();
        assert!(done.expect("mount can be run").success(), "{options}");
    }

    fn objects(&self) -> usize {
        let path = format!("/proc/{}/root/dev/shm", self.holder.pid());
        fs::read_dir(path).expect("the holder lives").count()
    }
}

/// The space left in shared memory.
#[derive(Debug, Clone, Copy)]
enum Left {
    Bytes(u64),
    Files(u64),
}

impl Left {
    /// True if the lack is reported, with numbers.
    fn is_reported(self, printed: &str) -> bool {
        match self {
            Self::Bytes(_) => printed.contains("bytes needed") && printed.contains("free"),
            Self::Files(_) => printed.contains("files needed") && printed.contains("free"),
        }
    }
}

/// A kind of process that joins a fleet.
struct Role {
    name: &'static str,
    command: fn(&OwnShm) -> Command,
    is_ready: fn(&mut Child) -> bool,
    end: fn(&mut Child) -> Ended,
}

const ROLES: [Role; 6] = [
    Role {
        name: "run",
        command: |shm| shm.joulebus(&["run"]),
        is_ready: |child| child.try_wait_for_line("ready:", PATIENCE).is_some(),
        end: Child::stop,
    },
    Role {
        name: "publish",
        command: |shm| shm.probe(&["controller", "newcomer", "50", "4", "30"]),
        is_ready: |child| !child.lines(0, PATIENCE).is_empty(),
        end: Child::finish,
    },
    Role {
        name: "planner",
        command: |shm| shm.probe(&["planner"]),
        is_ready: |child| !child.lines(0, PATIENCE).is_empty(),
        end: Child::finish,
    },
    Role {
        name: "consumer",
        command: |shm| shm.probe(&["consumer"]),
        is_ready: |child| !child.lines(0, PATIENCE).is_empty(),
        end: Child::finish,
    },
    Role {
        name: "watch",
        command: |shm| shm.joulebus(&["watch", "--format", "json"]),
        is_ready: |child| !child.lines(0, PATIENCE).is_empty(),
        end: Child::stop,
    },
    Role {
        name: "record",
        command: |shm| {
            let capture = shm.capture.display().to_string();
            let _ = fs::remove_file(&shm.capture);
            shm.joulebus(&["record", "-o", &capture])
        },
        is_ready: |child| child.try_wait_for_line("recording t into", PATIENCE).is_some(),
        // One that gets no processor in time loses messages, and reports that.
        end: |child| {
            let ended = child.end();
            assert!(matches!(ended.code(), Some(0 | 3)), "{ended:?}");
            ended
        },
    },
];

/// KiB left: pages, the memory of joining, the memory of ports, and values found to crash.
const LEFT_KIB: [u64; 14] = [0, 4, 8, 24, 60, 120, 180, 200, 240, 320, 480, 720, 1_100, 2_400];

/// Every second of these values, or those that the variable asks for.
fn some(values: impl IntoIterator<Item = u64>) -> impl Iterator<Item = u64> {
    values.into_iter().step_by(Dice::rounds("JOULEBUS_EVERY", 2) as usize)
}

/// Starts `at_once` processes of `role` concurrently with so much left. Returns how many were
/// ready; the others must have failed with the numbers.
fn start(shm: &OwnShm, role: &Role, at_once: usize, left: Left) -> usize {
    shm.leave(left);
    let mut children: Vec<Child> =
        (0..at_once).map(|_| Child::spawn(role.name, (role.command)(shm))).collect();
    let mut ready = 0;
    for child in &mut children {
        if (role.is_ready)(child) {
            ready += 1;
            continue;
        }
        let ended = child.wait();
        let what = format!("{} with {left:?}", role.name);
        assert_eq!(ended.signal(), None, "{what}: {ended:?}");
        assert_eq!(ended.code(), Some(1), "{what}: {ended:?}");
        let printed = ended.errors();
        assert!(left.is_reported(&printed), "{what}: {printed}");
    }
    for child in &mut children {
        if child.is_running() {
            // Ready processes must work until stopped, however little memory is left.
            (role.end)(child);
        }
    }
    shm.leave(Left::Bytes(1 << 30));
    shm.leave(Left::Files(1 << 16));
    ready
}

#[test]
fn row_24_joining_a_fleet_with_little_memory_left_works_or_fails_with_numbers() {
    let Some(shm) = OwnShm::new(&Setup::default()) else {
        return;
    };
    let mut worker = Child::spawn("worker", shm.joulebus(&["run", "--format", "json"]));
    worker.wait_for_line("ready:");
    let mut controller = Child::spawn("fleet", shm.probe(&["controller", "fleet", "0", "4", "30"]));
    let mut planner = Planner::new(Child::spawn("planner", shm.probe(&["planner"])));
    planner.forecast("it works", |frame| frame.robot(3).map(|_| ()));
    let (mut started, mut worked) = (0, 0);
    for role in &ROLES[1..] {
        let at_once = if role.name == "record" { 1 } else { 3 };
        for left in some(LEFT_KIB) {
            worked += start(&shm, role, at_once, Left::Bytes(left << 10));
            started += at_once;
            assert!(worker.is_running(), "{} {left}: {}", role.name, worker.tail());
            let newest = planner.forecasts().last().map(|frame| frame.tick);
            planner
                .forecast("the fleet goes on", |frame| (Some(frame.tick) > newest).then_some(()));
        }
    }
    assert!(controller.is_running(), "{}", controller.tail());
    controller.finish();
    planner.leave();
    worker.stop();
    assert_eq!(shm.objects(), 0, "nothing is left");
    figure(
        "row 24, newcomers with 0 to 2,400 KiB left",
        format_args!(
            "{worked} of {started} worked, the others were refused with numbers; SIGBUS 0"
        ),
    );
}

#[test]
fn row_24_the_first_process_with_little_memory_left_works_or_fails_with_numbers() {
    let Some(shm) = OwnShm::new(&Setup::default()) else {
        return;
    };
    let (mut started, mut worked) = (0, 0);
    for role in ROLES.iter().filter(|role| role.name != "watch") {
        for left in some(LEFT_KIB.into_iter().chain([6_000, 12_000])) {
            worked += start(&shm, role, 1, Left::Bytes(left << 10));
            started += 1;
            assert_eq!(shm.objects(), 0, "{} {left}: something is left", role.name);
        }
    }
    figure(
        "row 24, first processes with 0 to 12,000 KiB left",
        format_args!(
            "{worked} of {started} worked, the others were refused with numbers; SIGBUS 0"
        ),
    );
}

#[test]
fn row_24_the_first_process_with_few_files_left_works_or_names_their_number() {
    let Some(shm) = OwnShm::new(&Setup::default()) else {
        return;
    };
    let (mut started, mut worked) = (0, 0);
    for role in ROLES.iter().filter(|role| role.name != "watch") {
        for left in some([0, 1, 2, 3, 5, 8, 13, 21, 34, 100, 200]) {
            worked += start(&shm, role, 1, Left::Files(left));
            started += 1;
            assert_eq!(shm.objects(), 0, "{} {left}: something is left", role.name);
        }
    }
    assert!(worked >= 5, "{worked}");
    figure(
        "row 24, first processes with 0 to 200 files left",
        format_args!("{worked} of {started} worked, the others were refused with numbers"),
    );
}

/// Files of dead processes are removed before free memory is checked.
#[test]
fn row_24_memory_of_dead_processes_is_freed_for_the_next_start() {
    let Some(shm) = OwnShm::new(&Setup::default()) else {
        return;
    };
    let mut worker = Child::spawn("worker", shm.joulebus(&["run"]));
    worker.wait_for_line("ready:");
    worker.kill();
    // A fraction of what a worker needs. The dead one holds the rest, but not what its log of
    // alarms had not opened yet.
    shm.leave(Left::Bytes(6 << 20));
    let mut worker = Child::spawn("worker", shm.joulebus(&["run"]));
    worker.wait_for_line("ready:");
    worker.stop();
    assert_eq!(shm.objects(), 0, "nothing is left");
}
