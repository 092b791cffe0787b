//! A worker that cannot save its ledger says so, and a fleet never has two workers. That planners
//! learn of a killed one at once is tested in `consumer` (`a_killed_worker`), and that the next one
//! continues its ledger by the simulator, which kills at every access to the disk.

use joulebus_tests::{Arena, Child, Dice, Planner, Setup, eventually, figure};
use serde_json::Value;

/// True if the ledger file is whole and has accounts.
fn has_accounts(arena: &Arena) -> bool {
    let Ok(text) = std::fs::read(arena.ledger()) else { return false };
    let file: Value = serde_json::from_slice(&text).expect("a file that is there is whole");
    file["ledger"]["robots"].as_object().is_some_and(|robots| !robots.is_empty())
}

#[test]
fn a_worker_whose_ledger_cannot_be_saved_at_the_end_reports_it_and_ends_with_3() {
    let arena = Arena::new(&Setup {
        tick_hz: 100.0,
        rate_hz: 50.0,
        stale_after_s: 0.5,
        ledger: true,
        ..Setup::default()
    });
    let mut worker = arena.worker();
    let mut controller = arena.controller("controller", 0, 4, 50.0);
    eventually("some energy is written down", || has_accounts(&arena));
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
    assert!(has_accounts(&arena), "the newest ledger is whole");
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
