//! Random faults on a running fleet: its processes are killed, also while they start, ended, paused
//! one by one and all at once, flooded, sent false frames, and left without file descriptors, disk
//! or memory, in random order. A source and a reader beside them must not notice. At last all files
//! are removed. One seed is one fleet of some ten seconds; for hours:
//!
//! ```sh
//! JOULEBUS_RANDOM_FLEETS=1000 cargo test -p joulebus-tests --test system random_faults -- \
//!     --nocapture
//! ```
//!
//! With `JOULEBUS_WITNESS=1` packages of PyPI that use nothing of joulebus read every capture
//! (`tools/read_capture.py`), and forecasts while the faults happen (`tools/read_fleet.py`).

mod shortages;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::Duration;

use joulebus_capture_format::Reader;
use joulebus_testkit::OnDrop;
use joulebus_tests::{
    Arena, Child, Dice, Ended, Forge, MemoryGroup, Planner, ReaderLine, Setup, alone, figure,
    sample,
};
use joulebus_wire::{Quality, Sample};
use rustix::process::{Pid, Resource, Signal, kill_process};
use shortages::{SmallDisk, limited};

const FAULTS: u64 = 40;
/// Robots of each controller, and rate of their samples.
const ROBOTS: u32 = 3;
const RATE_HZ: f64 = 30.0;
/// First robots of the controllers.
const CONTROLLERS: [u32; 2] = [0, 10];
/// Robots of the source that floods.
const FLOOD: [u32; 2] = [30, 31];
/// Robots of the source that must not notice, and the pause between its frames.
const UNDISTURBED: [u32; 3] = [90, 91, 92];
const PACE: Duration = Duration::from_millis(5);
/// Maximum time until a process is killed at its start, a paused one continues, and between faults.
const START: Duration = Duration::from_millis(40);
const PAUSE: Duration = Duration::from_millis(300);
const CALM: Duration = Duration::from_millis(150);
/// Maximum time for which all are stopped, as on suspension, and one starts with little memory.
const SUSPENDED: Duration = Duration::from_millis(1_500);
const START_SHORT: Duration = Duration::from_millis(200);
/// Exit codes of a process without file descriptors, disk or memory: its own, and the dynamic
/// loader's, which opens libraries first.
const SHORT_OF_RESOURCES: [i32; 2] = [1, 127];
/// Processes that must not notice: the undisturbed source, its reader, and a planner.
type Beside = [AtomicU32; 3];

fn setup() -> Setup {
    Setup {
        tick_hz: 100.0,
        rate_hz: RATE_HZ,
        stale_after_s: 1.0,
        buffer_frames: 64,
        max_planners: 8,
        ledger: true,
        ..Setup::default()
    }
}

/// A process that may be killed at any time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Role {
    Worker,
    Controller(u32),
    Planner,
    Recorder,
}

const ROLES: [Role; 5] = [
    Role::Worker,
    Role::Controller(CONTROLLERS[0]),
    Role::Controller(CONTROLLERS[1]),
    Role::Planner,
    Role::Recorder,
];

/// The processes that may be killed; none of a role while it is down.
struct Fleet<'a> {
    arena: &'a Arena,
    members: [Option<Child>; ROLES.len()],
    /// Captures, and whether their recorder was killed.
    captures: Vec<(PathBuf, bool)>,
    /// True if a process had no file descriptors or no disk left: it may end with an error.
    starved: [bool; ROLES.len()],
    /// A disk of which little is left, where such can be mounted.
    small_disk: Option<SmallDisk>,
    kills: [u64; ROLES.len()],
}

impl<'a> Fleet<'a> {
    fn start(arena: &'a Arena) -> Self {
        let mut fleet = Self {
            arena,
            members: Default::default(),
            captures: Vec::new(),
            starved: Default::default(),
            small_disk: SmallDisk::mount(&arena.files().join("small")),
            kills: Default::default(),
        };
        fleet.complete();
        fleet
    }

    /// Starts a process without waiting for it.
    fn spawn(&mut self, role: Role) -> Child {
        let folder = self.arena.files().to_owned();
        let command = self.command(role, &folder);
        Child::spawn(&format!("{role:?}"), command)
    }

    /// The command of a process; a recorder writes into `folder`.
    fn command(&mut self, role: Role, folder: &Path) -> Command {
        match role {
            Role::Worker => self.arena.worker_command(),
            Role::Controller(first) => {
                let name = format!("controller-{first}");
                let numbers = [first.to_string(), ROBOTS.to_string(), RATE_HZ.to_string()];
                let arguments = ["controller", &name, &numbers[0], &numbers[1], &numbers[2]];
                self.arena.probe(&arguments)
            }
            Role::Planner => self.arena.probe(&["consumer"]),
            Role::Recorder => {
                let file = folder.join(format!("{}.mcap", self.captures.len()));
                let arguments = ["record", "--format", "json", "-o", name(&file)];
                let command = self.arena.command(&arguments);
                self.captures.push((file, false));
                command
            }
        }
    }

    /// Starts all that are down.
    fn complete(&mut self) {
        for (at, role) in ROLES.into_iter().enumerate() {
            let _ = self.take_starved(at);
            if self.members[at].is_none() {
                self.starved[at] = false;
                self.members[at] = Some(self.spawn(role));
            }
        }
    }

    /// A process that must run: no fault of another one ends it.
    fn take(&mut self, at: usize) -> Option<Child> {
        if self.take_starved(at) {
            return None;
        }
        let mut child = self.members[at].take()?;
        assert!(child.is_running(), "{:?} has ended: {}", ROLES[at], child.tail());
        Some(child)
    }

    /// Takes a process that has ended with an error for lack of file descriptors, if it has.
    fn take_starved(&mut self, at: usize) -> bool {
        let has_ended = |child: &mut Child| !child.is_running();
        if !self.starved[at] || !self.members[at].as_mut().is_some_and(has_ended) {
            return false;
        }
        if let Some(mut child) = self.members[at].take() {
            assert_ended(&child.wait(), &SHORT_OF_RESOURCES);
            // Its file may be missing, as after a kill.
            self.note_unfinished(ROLES[at]);
        }
        true
    }

    fn kill(&mut self, at: usize) {
        if let Some(mut child) = self.take(at) {
            assert_eq!(child.kill().signal(), Some(9));
            self.kills[at] += 1;
            self.note_unfinished(ROLES[at]);
        }
    }

    fn note_unfinished(&mut self, role: Role) {
        if role == Role::Recorder
            && let Some((_, killed)) = self.captures.last_mut()
        {
            *killed = true;
        }
    }

    /// Ends a process as an operator does.
    fn end(&mut self, at: usize) {
        let Some(mut child) = self.take(at) else {
            return;
        };
        let ended = match ROLES[at] {
            Role::Worker | Role::Recorder => child.end(),
            Role::Controller(_) | Role::Planner => child.finish(),
        };
        if ended.signal() == Some(15) {
            // It was about to start, and has no handler yet.
            return self.note_unfinished(ROLES[at]);
        }
        // A recorder that was paused has lost messages.
        let regular: &[i32] = match ROLES[at] {
            Role::Recorder => &[0, 3],
            _ => &[0],
        };
        if self.starved[at] && SHORT_OF_RESOURCES.contains(&ended.exit_code()) {
            return self.note_unfinished(ROLES[at]);
        }
        assert_ended(&ended, regular);
    }

    fn kill_while_starting(&mut self, at: usize, dice: &mut Dice) {
        if self.may_start_another(at) {
            let child = self.spawn(ROLES[at]);
            self.kill_started(at, child, dice.time_below(START));
        }
    }

    /// Same as [`Self::kill_while_starting`], with so little memory that the kernel may kill it
    /// first.
    fn start_with_little_memory(&mut self, at: usize, dice: &mut Dice) {
        let most = (2 + dice.below(40)) << 20;
        let Some(group) = MemoryGroup::new(most) else {
            return self.kill_while_starting(at, dice);
        };
        if self.may_start_another(at) {
            let folder = self.arena.files().to_owned();
            let command = group.within(&self.command(ROLES[at], &folder));
            let child = Child::spawn(&format!("{:?} in little memory", ROLES[at]), command);
            self.kill_started(at, child, dice.time_below(START_SHORT));
        }
    }

    /// The second of two workers that start at the same time remains, and the first one ends.
    fn may_start_another(&self, at: usize) -> bool {
        ROLES[at] != Role::Worker || self.members[at].is_none()
    }

    /// Kills a process that was started `after` that time, if nothing else has ended it.
    fn kill_started(&mut self, at: usize, mut child: Child, after: Duration) {
        std::thread::sleep(after);
        let ended = child.kill();
        let is_refused = ended.code().is_some_and(|code| SHORT_OF_RESOURCES.contains(&code));
        assert!(ended.signal() == Some(9) || is_refused, "{ended:?}");
        self.kills[at] += 1;
        if ROLES[at] == Role::Recorder {
            self.captures.last_mut().expect("just spawned").1 = true;
            // A recorder that still runs has an earlier file.
            if self.members[at].is_some() {
                let last = self.captures.len() - 1;
                self.captures.swap(last - 1, last);
            }
        }
    }

    fn pause(&mut self, at: usize, dice: &mut Dice) {
        if let Some(child) = &mut self.members[at] {
            child.signal(Signal::STOP);
            std::thread::sleep(dice.time_below(PAUSE));
            child.signal(Signal::CONT);
        }
    }

    /// No more files for a process than it has open, for a while.
    fn take_descriptors(&mut self, at: usize, dice: &mut Dice) {
        let Some(child) = &self.members[at] else {
            return;
        };
        let pid = child.pid();
        let opened = std::fs::read_dir(format!("/proc/{pid}/fd")).map_or(0, Iterator::count);
        self.starved[at] = true;
        limited(pid, Resource::Nofile, opened as u64, dice.time_below(PAUSE));
    }

    /// Limits files for a while to some bytes more than the longest one: the ledger and new objects
    /// in shared memory fail, and a capture ends. Only for programs of the project: one that uses a
    /// library of it decides for itself about the signal.
    fn limit_files(&mut self, at: usize, dice: &mut Dice) {
        let Some(child) = &self.members[at] else {
            return;
        };
        let longest = match ROLES[at] {
            Role::Worker => self.arena.ledger(),
            Role::Recorder => {
                self.captures.last().map(|(file, _)| file.clone()).unwrap_or_default()
            }
            Role::Controller(_) | Role::Planner => return,
        };
        let bytes = longest.metadata().map_or(0, |file| file.len()) + dice.below(20_000);
        self.starved[at] = true;
        limited(child.pid(), Resource::Fsize, bytes, dice.time_below(PAUSE));
    }

    /// A recorder on a disk that is full soon.
    fn fill_disk(&mut self, dice: &mut Dice) {
        let at = ROLES.len() - 1;
        let Some(disk) = &self.small_disk else {
            return self.limit_files(at, dice);
        };
        let folder = disk.folder().to_owned();
        disk.leave(dice.below(400_000));
        self.end(at);
        let command = self.command(Role::Recorder, &folder);
        self.starved[at] = true;
        self.members[at] = Some(Child::spawn("recorder on a small disk", command));
    }

    /// All processes are stopped at once for a while, those too that must not notice anything else.
    fn suspend(&mut self, beside: &Beside, dice: &mut Dice) {
        let members = self.members.iter().flatten().map(Child::pid);
        let beside = beside.iter().map(|pid| pid.load(Ordering::Relaxed));
        let pids: Vec<u32> = members.chain(beside).collect();
        let all = |signal| {
            for pid in pids.iter().filter_map(|pid| Pid::from_raw(pid.cast_signed())) {
                // It may have ended, and is waited for later.
                let _ = kill_process(pid, signal);
            }
        };
        all(Signal::STOP);
        std::thread::sleep(dice.time_below(SUSPENDED));
        all(Signal::CONT);
    }

    /// Removes all files of the fleet, as systemd-logind does. Its processes end with the reason.
    fn remove_files(&mut self) {
        // A process that has not joined yet would make new ones.
        if let Some(recorder) = self.members.last_mut().and_then(Option::as_mut) {
            recorder.wait_for_line("recording t into");
        }
        for path in self.arena.stale_files() {
            // Processes that notice remove theirs at the same time.
            let _ = fs::remove_file(&path).or_else(|_| fs::remove_dir_all(&path));
        }
        for (role, member) in ROLES.into_iter().zip(&mut self.members) {
            let Some(mut child) = member.take() else {
                continue;
            };
            match role {
                Role::Worker | Role::Recorder => assert_ended(&child.wait(), &[1]),
                // The library's users decide what these print at the end.
                Role::Controller(_) | Role::Planner => {
                    let ended = child.end();
                    let is_ended =
                        matches!(ended.code(), Some(0 | 1)) || ended.signal() == Some(15);
                    assert!(is_ended, "{ended:?}");
                }
            }
        }
        if let Some((_, unfinished)) = self.captures.last_mut() {
            *unfinished = true;
        }
        self.complete();
    }

    /// Frames without a pause from a source that then leaves or is killed.
    fn flood(&mut self, dice: &mut Dice) {
        let mut source = self.arena.source("flood");
        for seq in 0..200 {
            source.send(&FLOOD.map(|robot| sample(robot, seq, 1_000_000)));
        }
        if dice.chance(0.5) {
            source.child.kill();
        } else {
            source.leave();
        }
    }

    /// Sends frames in a controller's name, partly with impossible headers and samples, from a
    /// process that is then killed.
    fn forge(&mut self, dice: &mut Dice) {
        let first = CONTROLLERS[dice.below(CONTROLLERS.len() as u64) as usize];
        let mut impostor = self.arena.source(&format!("controller-{first}"));
        for _ in 0..20 {
            let number = |dice: &mut Dice| (dice.below(4) * (u64::MAX / 3)) ^ dice.below(100);
            let forge = Forge {
                schema: dice.chance(0.3).then(|| number(dice) as u32),
                samples_before: dice.chance(0.5).then(|| number(dice)),
                source_epoch: dice.chance(0.3).then(|| number(dice)),
            };
            let samples: Vec<Sample> = (0..ROBOTS)
                .map(|robot| {
                    let mut false_sample = sample(first + robot, 0, 1_000_000);
                    false_sample.seq = number(dice);
                    if dice.chance(0.5) {
                        false_sample.power_w = f32::from_bits(number(dice) as u32);
                        false_sample.stamp_ns = number(dice);
                    }
                    false_sample
                })
                .collect();
            impostor.send_forged(&samples, forge);
        }
        impostor.child.kill();
    }

    fn fault(&mut self, beside: &Beside, dice: &mut Dice) {
        let at = dice.below(ROLES.len() as u64) as usize;
        match dice.below(12) {
            0 | 1 => self.kill(at),
            2 => self.end(at),
            3 => self.pause(at, dice),
            4 => self.kill_while_starting(at, dice),
            5 => self.take_descriptors(at, dice),
            6 => self.forge(dice),
            7 => self.limit_files(at, dice),
            8 => self.fill_disk(dice),
            9 => self.start_with_little_memory(at, dice),
            10 => self.suspend(beside, dice),
            _ => self.flood(dice),
        }
        std::thread::sleep(dice.time_below(CALM));
        if dice.chance(0.6) {
            self.complete();
        }
    }

    /// Ends all processes, sources first.
    fn end_all(&mut self) {
        for at in (0..ROLES.len()).rev() {
            self.end(at);
        }
    }
}

fn name(file: &Path) -> &str {
    file.to_str().expect("ASCII file name")
}

fn assert_ended(ended: &Ended, codes: &[i32]) {
    assert!(codes.contains(&ended.exit_code()), "{ended:?}");
}

/// Sends frames one by one until stopped, each once a reader has the one before: no fault of others
/// may cost a frame. Returns their number.
fn undisturbed(arena: &Arena, setup: &Setup, beside: &Beside, stop: &AtomicBool) -> u64 {
    let mut reader = arena.recorder();
    let mut source = arena.source("undisturbed");
    let pid = source.child.pid();
    beside[1].store(pid, Ordering::Relaxed);
    beside[2].store(reader.child.pid(), Ordering::Relaxed);
    let mut frames = 0;
    while !stop.load(Ordering::Relaxed) {
        let frame: Vec<Sample> =
            UNDISTURBED.map(|robot| sample(robot, frames, setup.period_ns())).to_vec();
        source.send(&frame);
        reader.until("the undisturbed source's frame", |line| match line {
            ReaderLine::Samples { pid: of, samples, .. } if *of == pid => {
                assert_eq!(*samples, frame.len());
                Some(())
            }
            ReaderLine::Failed(error) => panic!("{error}"),
            _ => None,
        });
        frames += 1;
        std::thread::sleep(PACE);
    }
    source.leave();
    reader.leave();
    frames
}

/// Checks the output of a planner: runs and their ticks only grow, and each change of run is
/// announced. Returns the number of runs.
fn assert_in_order(planner: &mut Planner) -> u64 {
    let (mut last, mut runs) = (None, 0);
    for line in planner.seen() {
        match line {
            ReaderLine::Given { worker_epoch, tick, restarted, .. } => {
                let next = (*worker_epoch, *tick);
                assert!(last.is_none_or(|last| last < next), "{last:?} then {next:?}");
                let is_same = last.is_some_and(|(epoch, _)| epoch == *worker_epoch);
                assert!(last.is_none() || *restarted != is_same, "{last:?} then {line:?}");
                runs += u64::from(!is_same);
                last = Some(next);
            }
            ReaderLine::Failed(error) => panic!("{error}"),
            _ => {}
        }
    }
    runs
}

fn assert_readable(arena: &Arena, captures: &[(PathBuf, bool)]) -> u64 {
    let mut read = 0;
    if !is_witnessed() {
        println!("skipped: tools/read_*.py, because JOULEBUS_WITNESS is not set");
    }
    for (file, killed) in captures {
        let mut file = file.clone();
        if *killed {
            let whole = arena.files().join("recovered.mcap");
            let _ = std::fs::remove_file(&whole);
            let ended = alone(&["recover", name(&file), "-o", name(&whole)]);
            // Killed before it had written anything.
            if !whole.exists() {
                continue;
            }
            assert_ended(&ended, &[0, 3]);
            file = whole;
        }
        for entry in Reader::open(&file).unwrap_or_else(|error| panic!("{file:?}: {error}")) {
            entry.unwrap_or_else(|error| panic!("{file:?}: {error}"));
            read += 1;
        }
        if is_witnessed() {
            assert_read_by_others(&file);
        }
    }
    read
}

/// True if packages of PyPI read along.
fn is_witnessed() -> bool {
    std::env::var_os("JOULEBUS_WITNESS").is_some()
}

fn script(name: &str) -> Command {
    let mut command = Command::new("python3");
    command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("../tools").join(name));
    command
}

/// The package iceoryx2 reads the forecasts until its stdin is closed, by the documented layout.
fn read_by_iceoryx2(arena: &Arena) -> Child {
    let mut command = script("read_fleet.py");
    let domain = arena.domain();
    command.arg(domain.directory().join("iceoryx2.toml")).args(["--fleet", domain.fleet()]);
    let mut reader = Child::spawn("read_fleet.py", command);
    reader.wait_for_line("ready");
    reader
}

/// The packages of PyPI read what the project reads.
fn assert_read_by_others(file: &Path) {
    let mut command = script("read_capture.py");
    command.args([name(file), "--faults", "--joulebus"]);
    command.arg(joulebus_tests::program("joulebus-under-test"));
    let ended = Child::spawn("read_capture.py", command).wait();
    assert_eq!(ended.code(), Some(0), "{ended:?}");
}

/// One fleet; returns the kills of each role, and the frames of the undisturbed source.
fn run_fleet(dice: &mut Dice) -> ([u64; ROLES.len()], u64) {
    let setup = setup();
    let arena = Arena::new(&setup);
    let stop = AtomicBool::new(false);
    let mut witness = arena.consumer();
    let other = is_witnessed().then(|| read_by_iceoryx2(&arena));
    let beside = Beside::default();
    beside[0].store(witness.child.pid(), Ordering::Relaxed);
    let (mut fleet, frames) = std::thread::scope(|scope| {
        let source = scope.spawn(|| undisturbed(&arena, &setup, &beside, &stop));
        // The source must stop even if this thread panics.
        let stopped = OnDrop(&stop);
        let mut fleet = Fleet::start(&arena);
        for _ in 0..FAULTS {
            fleet.fault(&beside, dice);
        }
        // Without faults all goes on.
        for at in 0..ROLES.len() {
            if fleet.starved[at] {
                fleet.end(at);
            }
        }
        fleet.complete();
        let all: Vec<u32> = CONTROLLERS.into_iter().chain(UNDISTURBED).collect();
        assert_forecast(&arena, &all);
        drop(stopped);
        (fleet, source.join().expect("it was not disturbed"))
    });
    assert!(assert_in_order(&mut witness) > 0);
    witness.leave();
    if let Some(mut other) = other {
        let ended = other.finish();
        assert_ended(&ended, &[0]);
        figure("seen by the package iceoryx2", ended.text().trim());
    }
    if dice.chance(0.5) {
        fleet.remove_files();
        assert_forecast(&arena, &CONTROLLERS);
    }
    fleet.end_all();
    assert!(assert_readable(&arena, &fleet.captures) > 0);
    (fleet.kills, frames)
}

/// A planner that joins now gets forecasts of all these robots.
fn assert_forecast(arena: &Arena, robots: &[u32]) {
    let mut planner = arena.planner();
    for robot in robots {
        planner.quality("it is forecast", *robot, |quality| quality == Quality::Fresh);
    }
    planner.leave();
}

#[test]
fn random_faults_cost_an_undisturbed_source_no_frame_and_leave_nothing_behind() {
    let mut dice = Dice::roll();
    let fleets = Dice::rounds("JOULEBUS_RANDOM_FLEETS", 1);
    let (mut kills, mut frames) = ([0; ROLES.len()], 0);
    for fleet in 1..=fleets {
        let (more_kills, more_frames) = run_fleet(&mut dice);
        frames += more_frames;
        for (kills, more) in kills.iter_mut().zip(more_kills) {
            *kills += more;
        }
        let [worker, one, other, planner, recorder] = kills;
        let (faults, sources) = (fleet * FAULTS, one + other);
        figure(
            "random faults",
            format_args!(
                "{fleet} fleets, {faults} faults; killed: {worker} workers, {sources} sources, {planner} planners, \
                 {recorder} recorders; 0 of {frames} frames lost"
            ),
        );
    }
}
