//! Rows 2 and 17: the worker is killed at any point, and a fleet never has two.

use std::collections::BTreeMap;
use std::time::Duration;

use joulebus_bus::clock;
use joulebus_tests::{
    Arena, Child, Dice, FrameRead, Planner, ReaderLine, Setup, Spread, drawn_exact, eventually,
    figure, steady_uw,
};
use joulebus_wire::Budgets;
use serde_json::Value;

const ROBOTS: u32 = 4;

type Accounts = BTreeMap<u32, Value>;

fn with_ledger() -> Setup {
    Setup { tick_hz: 100.0, rate_hz: 50.0, stale_after_s: 0.5, ledger: true, ..Setup::default() }
}

/// The ledger file with this extension: generation, and accounts by robot. A file being written
/// cannot be read yet; any other must be intact.
fn generation(arena: &Arena, ending: &str) -> Option<(u64, Accounts)> {
    let mut path = arena.ledger().into_os_string();
    path.push(ending);
    let text = std::fs::read_to_string(path).ok()?;
    let file: Value = match serde_json::from_str(&text) {
        Ok(file) => file,
        Err(_) if ending == ".new" => return None,
        Err(error) => panic!("{error}: {text}"),
    };
    let robots = file["ledger"]["robots"].as_object().expect("accounts");
    let robots = robots.iter();
    let accounts = robots.map(|(robot, account)| (robot.parse().expect("an id"), account.clone()));
    Some((file["generation"].as_u64()?, accounts.collect()))
}

/// The newest accounts on disk; none if there is no file. A kill at any point leaves an intact
/// file.
fn written_down(arena: &Arena) -> Option<Accounts> {
    let found = ["", ".older", ".new"].map(|ending| generation(arena, ending));
    let newest = found.into_iter().flatten().max_by_key(|(number, _)| *number);
    newest.map(|(_, accounts)| accounts)
}

fn number(account: &Value, name: &str) -> u64 {
    account[name].as_u64().unwrap_or_else(|| panic!("{name} in {account}"))
}

/// Checks every ledger of every frame of budgets: time adds up to the nanosecond, energy to the
/// last digit.
#[derive(Default)]
struct Audit {
    /// Stamp of each robot's first sample, ns.
    first_ns: BTreeMap<u32, u64>,
    ledgers: u64,
}

impl Audit {
    fn check(&mut self, frame: &FrameRead<Budgets>) {
        for line in frame.robots.iter().filter(|line| line.stamp_ns > 0) {
            let elapsed_ns = line.metered_ns + line.unmetered_ns;
            let first_ns = *self.first_ns.entry(line.robot).or_insert(line.stamp_ns - elapsed_ns);
            assert_eq!(
                elapsed_ns,
                line.stamp_ns - first_ns,
                "metered + unmetered = elapsed: {line:?}"
            );
            let drawn = 2 * steady_uw(line.robot) * i128::from(line.metered_ns);
            assert_eq!(drawn_exact(line), drawn, "energy over the metered time: {line:?}");
            self.ledgers += 1;
        }
    }
}

#[test]
fn row_2_killed_workers_are_detected_at_once_and_the_ledger_continues_exactly_from_its_checkpoint()
{
    let mut dice = Dice::roll();
    let rounds = Dice::rounds("JOULEBUS_WORKER_KILLS", 20);
    let arena = Arena::new(&with_ledger());
    let mut planner = arena.planner();
    let mut consumer = arena.consumer();
    let mut controller = arena.controller("controller", 0, ROBOTS, 50.0);
    let (mut to_frame, mut to_forecast, mut noticed) =
        (Spread::default(), Spread::default(), Spread::default());
    let (mut lost, mut audit, mut starting) = (Spread::default(), Audit::default(), 0);
    let mut epochs = Vec::new();
    for round in 0..rounds {
        let started_ns = clock::monotonic_ns();
        let before = written_down(&arena).unwrap_or_default();
        let mut worker = arena.spawn_worker();
        let pid = worker.pid();
        let (epoch, frame_ns) = planner.forecast("the first frame", |frame| {
            (frame.pid == pid && !frame.robots.is_empty())
                .then_some((frame.worker_epoch, frame.read_ns))
        });
        to_frame.add_ns(frame_ns - started_ns);
        assert!(epochs.last().is_none_or(|last| *last < epoch), "a later run has a greater epoch");
        epochs.push(epoch);
        let budgets = planner.until("budgets", |line| match line {
            // The first ticks may precede the first sample.
            ReaderLine::Budgets(frame)
                if frame.worker_epoch == epoch && !frame.robots.is_empty() =>
            {
                Some(frame.clone())
            }
            _ => None,
        });
        for (robot, account) in &before {
            let now = budgets.robot(*robot).expect("its account continues");
            assert!(
                now.metered_ns >= number(account, "metered_ns"),
                "robot {robot}: {account} {now:?}"
            );
            let gap_ns = now.unmetered_ns - number(account, "unmetered_ns");
            assert!(gap_ns > 0, "the gap is unmetered: robot {robot}: {account} {now:?}");
        }
        let forecast_ns = planner.forecast("the first forecast", |frame| {
            (frame.worker_epoch == epoch && frame.robots.iter().any(|line| line.flags & 1 != 0))
                .then_some(frame.read_ns)
        });
        to_forecast.add_ns(forecast_ns - started_ns);
        // A planner without a processor until this worker's frames are gone never learns of it.
        consumer.until("the planner has a frame of it", |line| match line {
            ReaderLine::Given { worker_epoch, .. } => (*worker_epoch == epoch).then_some(()),
            _ => None,
        });
        if round == 0 {
            eventually("the ledger is saved", || {
                written_down(&arena).is_some_and(|robots| robots.len() == ROBOTS as usize)
            });
        }
        // Random time of the kill, not a wait for a condition.
        std::thread::sleep(dice.time_below(Duration::from_millis(300)));
        let killed_ns = clock::monotonic_ns();
        assert_eq!(worker.kill().signal(), Some(9));
        let gone_ns = consumer.until("the planner is told", |line| match line {
            // A worker killed during its start may have been detected, and reported gone, before.
            ReaderLine::WorkerGone { end, at_ns } if *at_ns >= killed_ns => {
                assert_eq!(end, "Exited", "seen by the kernel's word, not by a time-out");
                Some(*at_ns)
            }
            _ => None,
        });
        noticed.add_ns(gone_ns - killed_ns);
        if round % 3 == 2 {
            // Another one is killed during its start.
            let mut unfinished = arena.spawn_worker();
            std::thread::sleep(dice.time_below(Duration::from_millis(40)));
            unfinished.kill();
            starting += 1;
        }
        let after = written_down(&arena).expect("written in the first round");
        let last = planner.seen().iter().rev().find_map(|line| match line {
            ReaderLine::Budgets(frame) => frame.robot(0).copied(),
            _ => None,
        });
        let last = last.expect("budgets have been read");
        lost.add_ns(last.metered_ns.saturating_sub(number(&after[&0], "metered_ns")));
    }
    let mut worker = arena.worker();
    planner.forecast("the last restart", |frame| {
        (frame.pid == worker.pid() && !frame.robots.is_empty()).then_some(())
    });
    for line in planner.seen() {
        if let ReaderLine::Budgets(frame) = line {
            audit.check(frame);
        }
    }
    controller.finish();
    planner.leave();
    consumer.leave();
    let report = worker.stop().json();
    assert_eq!(report["frames_unsent"], 0);
    let ledger = written_down(&arena).expect("a worker that is stopped writes its ledger down");
    assert_eq!(ledger.len(), ROBOTS as usize);
    figure("row 2, start of a worker to its first frame", &to_frame);
    figure("row 2, start of a worker to its first forecast (five samples at 50 Hz)", &to_forecast);
    figure("row 2, kill to the planner knowing", &noticed);
    figure("row 2, metered time lost to a kill, now unmetered", &lost);
    figure(
        "row 2, ledger error",
        format_args!(
            "0 µJ and 0 ns in {} ledgers, {rounds} kills while ticking, {starting} while starting",
            audit.ledgers
        ),
    );
}

#[test]
fn a_worker_whose_ledger_cannot_be_saved_at_the_end_reports_it_and_ends_with_3() {
    let arena = Arena::new(&with_ledger());
    let mut worker = arena.worker();
    let mut controller = arena.controller("controller", 0, ROBOTS, 50.0);
    eventually("some energy is written down", || {
        generation(&arena, "").is_some_and(|(_, accounts)| !accounts.is_empty())
    });
    // No save can be renamed to a folder that is not empty; the newest ledger stays.
    let older = arena.ledger().with_extension("json.older");
    eventually("a folder takes its place between two saves", || {
        let _ = std::fs::remove_file(&older);
        std::fs::create_dir_all(older.join("somebody's")).is_ok()
    });
    worker.wait_for_line("the ledger was not saved");
    controller.finish();
    let ended = worker.end();
    assert_eq!(ended.code(), Some(3), "{}", ended.errors());
    assert_eq!(ended.json()["ledger_unsaved"], true);
    assert!(generation(&arena, "").is_some(), "the newest ledger is whole");
    std::fs::remove_dir_all(&older).expect("the arena's own directory");
}

/// The runs of workers in the order of their frames; panics if a run reappears after another.
fn runs(planner: &mut Planner) -> Vec<u64> {
    let mut runs: Vec<u64> = Vec::new();
    for frame in planner.forecasts() {
        if runs.last() != Some(&frame.worker_epoch) {
            assert!(!runs.contains(&frame.worker_epoch), "two workers at once");
            runs.push(frame.worker_epoch);
        }
    }
    runs
}

#[test]
fn row_17_of_eight_concurrent_workers_one_serves_and_after_its_death_another_can() {
    const RACERS: usize = 8;
    let rounds = Dice::rounds("JOULEBUS_RACES", 4);
    let arena = Arena::new(&Setup::default());
    let mut planner = arena.planner();
    for _ in 0..rounds {
        let mut racers: Vec<Child> = (0..RACERS).map(|_| arena.spawn_worker()).collect();
        eventually("all but one give up", || {
            racers.iter_mut().filter_map(|racer| racer.is_running().then_some(())).count() == 1
        });
        let at = racers.iter_mut().position(Child::is_running).expect("one");
        let mut owner = racers.swap_remove(at);
        owner.wait_for_line("ready:");
        for mut loser in racers {
            let ended = loser.wait();
            assert_eq!(ended.code(), Some(1), "{ended:?}");
            let owner_pid = format!("pid {}", owner.pid());
            assert!(ended.errors().contains(&owner_pid), "{}", ended.errors());
        }
        let pid = owner.pid();
        planner.forecast("it ticks", |frame| (frame.pid == pid).then_some(()));
        owner.kill();
    }
    let last = arena.worker();
    let pid = last.pid();
    planner.forecast("it ticks", |frame| (frame.pid == pid).then_some(()));
    assert_eq!(runs(&mut planner).len() as u64, rounds + 1);
    figure("row 17, owners at once", format_args!("1 in {rounds} races of {RACERS}"));
}
