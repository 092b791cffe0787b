//! Processes under the system calls that Docker leaves a container, and processes that the kernel
//! kills because memory runs out.

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

use joulebus_bus::clock;
use joulebus_testkit::eventually;
use joulebus_tests::{
    Arena, Child, Ended, MemoryGroup, Planner, ReaderLine, Setup, alone, as_in_docker, figure,
    without_loss,
};
use joulebus_wire::{Forecast, Quality};

fn setup() -> Setup {
    Setup {
        tick_hz: 30.0,
        rate_hz: 30.0,
        stale_after_s: 2.0,
        leave_after_s: 60.0,
        buffer_frames: 256,
        ledger: true,
        ..Setup::default()
    }
}

fn is_forecast(line: &Forecast) -> bool {
    matches!(line.quality(), Quality::Fresh | Quality::Held)
}

/// Waits for a frame that is read from now on and has forecasts of exactly these robots.
fn forecast_of(planner: &mut Planner, robots: &[u32]) {
    let now_ns = clock::monotonic_ns();
    planner.forecast("forecasts of all robots", |frame| {
        let given = frame.robots.iter().filter(|line| is_forecast(line)).map(|line| line.robot);
        // They are in the order in which they joined, and sources start at the same time.
        let given: BTreeSet<u32> = given.collect();
        (frame.read_ns > now_ns && given.iter().eq(robots)).then_some(())
    });
}

/// Waits until the planner has a frame. One that has none of a worker never learns of its end.
fn has_frame(consumer: &mut Planner) {
    let given = |line: &ReaderLine| matches!(line, ReaderLine::Given { .. }).then_some(());
    consumer.until("a frame", given);
}

fn recorder(arena: &Arena, file: &Path) -> Command {
    arena.command(&["record", "--format", "json", "-o", file.to_str().unwrap()])
}

/// Waits until a recorder has written several times.
fn has_grown(file: &Path) {
    let mut sizes = BTreeSet::new();
    eventually("a recorder writes", || {
        sizes.insert(std::fs::metadata(file).map_or(0, |found| found.len()));
        sizes.len() > 4
    });
}

fn verified(file: &Path) {
    // Ticks around a kill may lack a frame.
    let verified = alone(&["replay", "--verify", file.to_str().unwrap()]);
    assert!(matches!(verified.code(), Some(0 | 3)), "{verified:?}");
    let verified = verified.json();
    assert!(verified["ticks_verified"].as_u64() > Some(0), "{verified}");
    assert_eq!(verified["differences"], 0, "{verified}");
}

#[test]
fn no_process_needs_a_call_or_a_capability_that_docker_forbids() {
    let arena = Arena::new(&setup());
    let spawn = |name: &str, command: Command| Some(Child::spawn(name, as_in_docker(&command)?));
    let (file, _) = without_loss(|attempt| {
        let file = arena.files().join(format!("{attempt}.mcap"));
        let Some(mut worker) = spawn("worker", arena.worker_command()) else {
            return (None, alone(&["--version"]));
        };
        worker.wait_for_line("ready:");
        let mut recorder = spawn("recorder", recorder(&arena, &file)).unwrap();
        recorder.wait_for_line("recording t into");
        let mut planner = Planner::new(spawn("planner", arena.probe(&["planner"])).unwrap());
        let mut consumer = Planner::new(spawn("consumer", arena.probe(&["consumer"])).unwrap());
        let controller = arena.probe(&["controller", "controller", "0", "4", "30"]);
        let mut controller = spawn("controller", controller).unwrap();
        forecast_of(&mut planner, &[0, 1, 2, 3]);
        has_frame(&mut consumer);
        // Members see the end of others by locks, by pids and by `/proc`.
        assert_eq!(worker.kill().signal(), Some(9));
        consumer.until("the worker is gone", |line| match line {
            ReaderLine::WorkerGone { .. } => Some(()),
            _ => None,
        });
        let mut worker = spawn("worker", arena.worker_command()).unwrap();
        worker.wait_for_line("ready:");
        forecast_of(&mut planner, &[0, 1, 2, 3]);
        let ask = ["ask", "--robot", "2", "--idle", "3", "--format", "json"];
        let asked = spawn("ask", arena.command(&ask)).unwrap().wait();
        assert_eq!(asked.json()["answers"].as_array().map(Vec::len), Some(1), "{asked:?}");
        let doctor = spawn("doctor", arena.command(&["doctor"])).unwrap().wait();
        assert_eq!(doctor.code(), Some(0), "{doctor:?}");
        controller.kill();
        planner.leave();
        consumer.leave();
        let ended = recorder.end();
        worker.stop();
        (Some(file), ended)
    });
    if let Some(file) = file {
        verified(&file);
    }
}

/// A process to kill: its name, its command, and what is forecast while it is gone.
type Victim = (&'static str, fn(&Arena) -> Command, &'static [u32]);

const VICTIMS: [Victim; 4] = [
    ("worker", Arena::worker_command, &[]),
    ("source", |arena| arena.probe(&["controller", "far", "2", "2", "30"]), &[0, 1]),
    ("planner", |arena| arena.probe(&["consumer"]), &[0, 1]),
    ("recorder", |arena| recorder(arena, &arena.files().join("killed.mcap")), &[0, 1]),
];

/// Enough for each of them, with the shared memory that it makes.
const GROUP_BYTES: u64 = 160 << 20;

#[test]
fn others_go_on_and_the_next_works_when_the_kernel_kills_a_process_for_memory() {
    for (name, command, meanwhile) in VICTIMS {
        let Some(group) = MemoryGroup::new(GROUP_BYTES) else { return };
        let arena = Arena::new(&setup());
        let start = || Child::spawn(name, group.first_to_die(&command(&arena)));
        let mut beside = (name != "worker").then(|| arena.worker());
        let (mut planner, mut consumer) = (arena.planner(), arena.consumer());
        let mut near = arena.controller("near", 0, 2, 30.0);
        let with_it: &[u32] = if name == "source" { &[0, 1, 2, 3] } else { &[0, 1] };
        let works = |victim: &mut Child, planner: &mut Planner| {
            match name {
                "worker" => drop(victim.wait_for_line("ready:")),
                "recorder" => {
                    victim.wait_for_line("recording t into");
                    has_grown(&arena.files().join("killed.mcap"));
                }
                "planner" => assert!(!victim.lines(3, joulebus_tests::PATIENCE).is_empty()),
                _ => {}
            }
            forecast_of(planner, with_it);
        };
        let mut victim = start();
        works(&mut victim, &mut planner);
        has_frame(&mut consumer);
        group.exhaust();
        let killed: Ended = victim.wait();
        assert_eq!(killed.signal(), Some(9), "{name}: {killed:?}");
        if name == "worker" {
            consumer.until("the worker is gone", |line| match line {
                ReaderLine::WorkerGone { end, .. } => {
                    assert_eq!(end, "Exited");
                    Some(())
                }
                _ => None,
            });
        } else {
            forecast_of(&mut planner, meanwhile);
        }
        if name == "recorder" {
            let killed = arena.files().join("killed.mcap");
            let (from, to) = (killed.to_str().unwrap(), arena.files().join("recovered.mcap"));
            let recovered = alone(&["recover", from, "-o", to.to_str().unwrap()]);
            assert!(matches!(recovered.code(), Some(0 | 3)), "{recovered:?}");
            verified(&to);
            std::fs::remove_file(killed).unwrap();
        }
        // In the same group, which still pays for the shared memory that the first one made.
        let mut next = start();
        works(&mut next, &mut planner);
        let ended = match name {
            "worker" | "recorder" => next.end(),
            _ => next.finish(),
        };
        assert!(matches!(ended.code(), Some(0 | 3)), "{name}: {ended:?}");
        near.kill();
        planner.leave();
        consumer.leave();
        beside.as_mut().map(Child::stop);
        figure("out of memory", format_args!("{name} killed by the kernel and started again"));
    }
}
