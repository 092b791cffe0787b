//! Random faults on a running fleet: its processes are killed, ended, paused, killed while they start,
//! flooded, sent false frames, and left without file descriptors, in random order, beside a source and a reader that must not notice. One seed is one
//! fleet of some ten seconds; for hours, `JOULEBUS_RANDOM_FLEETS=1000 cargo test -p joulebus-tests
//! --test random_faults -- --nocapture`.

#[path = "../on_drop.rs"]
mod on_drop;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use joulebus_capture::Reader;
use joulebus_tests::{
    Arena, Child, Dice, Ended, Forge, Planner, ReaderLine, Setup, alone, figure, sample,
};
use joulebus_wire::{Quality, Sample};
use on_drop::OnDrop;
use rustix::process::{Pid, Resource, Rlimit, Signal, getrlimit, prlimit};

/// Faults of one fleet.
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
/// Most time until a process is killed at its start, until a paused one continues, and between two faults.
const START: Duration = Duration::from_millis(40);
const PAUSE: Duration = Duration::from_millis(300);
const CALM: Duration = Duration::from_millis(150);
/// Exit codes of a process without file descriptors: its own, and the dynamic loader's, which opens the
/// libraries before the program begins.
const OUT_OF_DESCRIPTORS: [i32; 2] = [1, 127];

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
    /// Whether a process had no file descriptors left: it may end with an error.
    starved: [bool; ROLES.len()],
    kills: u64,
}

impl<'a> Fleet<'a> {
    fn start(arena: &'a Arena) -> Self {
        let mut fleet = Self {
            arena,
            members: Default::default(),
            captures: Vec::new(),
            starved: Default::default(),
            kills: 0,
        };
        fleet.complete();
        fleet
    }

    /// Starts a process without waiting for it.
    fn spawn(&mut self, role: Role) -> Child {
        match role {
            Role::Worker => self.arena.spawn_worker(),
            Role::Controller(first) => {
                let name = format!("controller-{first}");
                self.arena.controller(&name, first, ROBOTS, RATE_HZ)
            }
            Role::Planner => Child::spawn("planner", self.arena.probe(&["consumer"])),
            Role::Recorder => {
                let file = self
                    .arena
                    .files()
                    .join(format!("{}.mcap", self.captures.len()));
                let arguments = ["record", "--format", "json", "-o", name(&file)];
                let recorder = Child::spawn("recorder", self.arena.command(&arguments));
                self.captures.push((file, false));
                recorder
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
        assert!(
            child.is_running(),
            "{:?} has ended: {}",
            ROLES[at],
            child.tail()
        );
        Some(child)
    }

    /// Takes a process that has ended with an error for lack of file descriptors, if it has.
    fn take_starved(&mut self, at: usize) -> bool {
        let has_ended = |child: &mut Child| !child.is_running();
        if !self.starved[at] || !self.members[at].as_mut().is_some_and(has_ended) {
            return false;
        }
        if let Some(mut child) = self.members[at].take() {
            assert_ended(&child.wait(), &OUT_OF_DESCRIPTORS);
            // Its file may be missing, as after a kill.
            self.note_unfinished(ROLES[at]);
        }
        true
    }

    fn kill(&mut self, at: usize) {
        if let Some(mut child) = self.take(at) {
            assert_eq!(child.kill().signal(), Some(9));
            self.kills += 1;
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
        if self.starved[at] && OUT_OF_DESCRIPTORS.contains(&ended.exit_code()) {
            return self.note_unfinished(ROLES[at]);
        }
        assert_ended(&ended, regular);
    }

    fn kill_while_starting(&mut self, at: usize, dice: &mut Dice) {
        let role = ROLES[at];
        if role == Role::Worker && self.members[at].is_some() {
            // The second of two that start at the same time remains, and the first one ends.
            return;
        }
        let mut child = self.spawn(role);
        std::thread::sleep(dice.time_below(START));
        child.kill();
        self.kills += 1;
        if role == Role::Recorder {
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
        let limit = |files| {
            let before = getrlimit(Resource::Nofile);
            let limit = Rlimit {
                current: files,
                ..before
            };
            // It may have ended.
            let _ = prlimit(Pid::from_raw(pid.cast_signed()), Resource::Nofile, limit);
            before.current
        };
        self.starved[at] = true;
        let before = limit(Some(opened as u64));
        std::thread::sleep(dice.time_below(PAUSE));
        limit(before);
    }

    /// Frames without a pause from a source that then leaves or is killed.
    fn flood(&mut self, dice: &mut Dice) {
        let mut source = self.arena.source("flood");
        for seq in 0..200 {
            source.send(&FLOOD.map(|robot| sample(robot, seq, 1_000_000)));
        }
        if dice.chance(0.5) {
            source.child.kill();
            self.kills += 1;
        } else {
            source.leave();
        }
    }

    /// Frames in the name of a controller, with headers and samples that are partly impossible, from a process that is
    /// then killed.
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
        self.kills += 1;
    }

    fn fault(&mut self, dice: &mut Dice) {
        let at = dice.below(ROLES.len() as u64) as usize;
        match dice.below(8) {
            0 | 1 => self.kill(at),
            2 => self.end(at),
            3 => self.pause(at, dice),
            4 => self.kill_while_starting(at, dice),
            5 => self.take_descriptors(at, dice),
            6 => self.forge(dice),
            _ => self.flood(dice),
        }
        std::thread::sleep(dice.time_below(CALM));
        if dice.chance(0.6) {
            self.complete();
        }
    }

    /// Ends all processes, sources first; returns the captures.
    fn finish(mut self) -> Vec<(PathBuf, bool)> {
        for at in (0..ROLES.len()).rev() {
            self.end(at);
        }
        self.captures
    }
}

fn name(file: &Path) -> &str {
    file.to_str().expect("ASCII file name")
}

fn assert_ended(ended: &Ended, codes: &[i32]) {
    assert!(codes.contains(&ended.exit_code()), "{ended:?}");
}

/// Sends a frame, waits until a reader beside it has it, and so on, until stopped: no fault of others may
/// cost a frame. Returns their number.
fn undisturbed(arena: &Arena, setup: &Setup, stop: &AtomicBool) -> u64 {
    let mut reader = arena.recorder();
    let mut source = arena.source("undisturbed");
    let pid = source.child.pid();
    let mut frames = 0;
    while !stop.load(Ordering::Relaxed) {
        let frame: Vec<Sample> = UNDISTURBED
            .map(|robot| sample(robot, frames, setup.period_ns()))
            .to_vec();
        source.send(&frame);
        reader.until("the undisturbed source's frame", |line| match line {
            ReaderLine::Samples {
                pid: of, samples, ..
            } if *of == pid => {
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

/// What a planner was told: runs and their ticks only grow, and each change of run is announced.
/// Returns the number of runs.
fn assert_in_order(planner: &mut Planner) -> u64 {
    let (mut last, mut runs) = (None, 0);
    for line in planner.seen() {
        match line {
            ReaderLine::Given {
                worker_epoch,
                tick,
                restarted,
                ..
            } => {
                let next = (*worker_epoch, *tick);
                assert!(
                    last.is_none_or(|last| last < next),
                    "{last:?} then {next:?}"
                );
                let is_same = last.is_some_and(|(epoch, _)| epoch == *worker_epoch);
                assert!(
                    last.is_none() || *restarted != is_same,
                    "{last:?} then {line:?}"
                );
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
    }
    read
}

/// One fleet; returns the kills, and the frames of the undisturbed source.
fn run_fleet(dice: &mut Dice) -> (u64, u64) {
    let setup = setup();
    let arena = Arena::new(&setup);
    let stop = AtomicBool::new(false);
    let mut witness = arena.consumer();
    let (fleet, frames) = std::thread::scope(|scope| {
        let source = scope.spawn(|| undisturbed(&arena, &setup, &stop));
        // The source must stop even if this thread panics.
        let stopped = OnDrop(&stop);
        let mut fleet = Fleet::start(&arena);
        for _ in 0..FAULTS {
            fleet.fault(dice);
        }
        // Without faults all goes on.
        for at in 0..ROLES.len() {
            if fleet.starved[at] {
                fleet.end(at);
            }
        }
        fleet.complete();
        let mut planner = arena.planner();
        for robot in CONTROLLERS.into_iter().chain(UNDISTURBED) {
            planner.quality("it is forecast", robot, |quality| quality == Quality::Fresh);
        }
        planner.leave();
        drop(stopped);
        (fleet, source.join().expect("it was not disturbed"))
    });
    let kills = fleet.kills;
    let captures = fleet.finish();
    assert!(assert_in_order(&mut witness) > 0);
    witness.leave();
    assert!(assert_readable(&arena, &captures) > 0);
    arena.close();
    (kills, frames)
}

#[test]
fn random_faults_cost_an_undisturbed_source_no_frame_and_leave_nothing_behind() {
    let mut dice = Dice::roll();
    let fleets = Dice::rounds("JOULEBUS_RANDOM_FLEETS", 2);
    let (mut kills, mut frames) = (0, 0);
    for fleet in 1..=fleets {
        let (more_kills, more_frames) = run_fleet(&mut dice);
        (kills, frames) = (kills + more_kills, frames + more_frames);
        figure(
            "random faults",
            format_args!(
                "{fleet} fleets, {} faults, {kills} kills, 0 of {frames} frames lost",
                fleet * FAULTS
            ),
        );
    }
}
