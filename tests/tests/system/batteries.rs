//! Batteries over the restart of a worker that was configured with nothing but their capacity.

use joulebus_tests::{Arena, Setup, eventually};
use serde_json::Value;

const ROBOTS: u32 = 3;

fn setup() -> Setup {
    Setup {
        rate_hz: 50.0,
        stale_after_s: 0.5,
        default_ledger: true,
        // A few watts empty it within minutes.
        more: "[platform.battery]\ncapacity_wh = 0.05\ninitial_soc_lo = 1.0\n".to_owned(),
        ..Setup::default()
    }
}

/// Generation and states of charge in the file that the worker saves by default, once there is one.
fn saved(arena: &Arena) -> Option<(u64, Vec<f64>)> {
    let entries = std::fs::read_dir(arena.state().join("joulebus")).ok()?;
    let mut files = entries.flatten().map(|entry| entry.path());
    let path = files.find(|path| path.extension().is_some_and(|ending| ending == "json"))?;
    let file: Value = serde_json::from_str(&std::fs::read_to_string(path).ok()?).ok()?;
    let robots = file["ledger"]["robots"].as_object()?.values();
    let socs: Option<Vec<f64>> = robots.map(|robot| robot["battery"]["soc"].as_f64()).collect();
    Some((file["generation"].as_u64()?, socs?))
}

#[test]
fn a_killed_worker_saves_batteries_by_default_and_the_next_one_does_not_fill_them() {
    let arena = Arena::new(&setup());
    let mut controller = arena.controller("controller", 0, ROBOTS, 50.0);
    let mut worker = arena.worker();
    eventually("all robots have drawn a twentieth", || {
        saved(&arena).is_some_and(|(_, socs)| {
            socs.len() == ROBOTS as usize && socs.iter().all(|soc| *soc < 0.95)
        })
    });
    assert_eq!(worker.kill().signal(), Some(9));
    let (generation, before) = saved(&arena).expect("it was there");
    let mut worker = arena.worker();
    let mut after = Vec::new();
    eventually("the next worker has saved them", || {
        let newer = saved(&arena).filter(|(newer, _)| *newer > generation + 1);
        newer.is_some_and(|(_, socs)| {
            after = socs;
            after.len() == ROBOTS as usize
        })
    });
    for (after, before) in after.iter().zip(&before) {
        assert!(after < before, "{after} of {before}");
    }
    controller.kill();
    worker.stop();
    arena.close();
}

#[test]
fn a_fleet_without_batteries_saves_nothing_by_default() {
    let arena = Arena::new(&Setup { platform: "builtin:rover", more: String::new(), ..setup() });
    let mut worker = arena.worker();
    worker.stop();
    assert!(!arena.state().exists());
    arena.close();
}
