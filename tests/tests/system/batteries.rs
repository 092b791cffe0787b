//! Batteries over the restart of a worker that was configured with nothing but their capacity.

use joulebus_bus::clock;
use joulebus_tests::{Arena, Setup, eventually, steady};
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

/// The bounds that are saved of a robot's state of charge, once there are any.
fn bounds(arena: &Arena, robot: u32) -> Option<(f64, f64)> {
    let file: Value = serde_json::from_slice(&std::fs::read(arena.ledger()).ok()?).ok()?;
    let battery = &file["ledger"]["robots"][robot.to_string()]["battery"];
    Some((battery["soc_lo"].as_f64()?, battery["soc_hi"].as_f64()?))
}

/// Sends a sample of each of these robots, the first one's the oldest, until all are saved.
fn report(arena: &Arena, robots: std::ops::Range<u32>) {
    let mut source = arena.source("robots");
    let mut seq = 0;
    eventually("the robots are saved", || {
        let now_ns = clock::monotonic_ns();
        let sample = |robot| steady(robot, seq, now_ns + u64::from(robot));
        source.send(&robots.clone().map(sample).collect::<Vec<_>>());
        seq += 1;
        seq > 3 && robots.clone().all(|robot| bounds(arena, robot).is_some())
    });
}

#[test]
fn a_lowered_capacity_takes_no_account_and_a_robot_that_has_none_is_unknown() {
    let of = |capacity| Setup {
        capacity,
        ledger: true,
        default_ledger: false,
        more: "[platform.battery]\ncapacity_wh = 20.0\ninitial_soc_lo = 0.9\n".to_owned(),
        ..setup()
    };
    let is_known = |bounds: Option<(f64, f64)>| bounds.is_some_and(|(lo, _)| lo > 0.5);
    let arena = Arena::new(&of(6));
    let mut worker = arena.worker();
    report(&arena, 0..6);
    worker.stop();
    assert!((0..6).all(|robot| is_known(bounds(&arena, robot))));
    arena.configure(&of(2));
    let mut worker = arena.spawn_worker();
    worker.wait_for_line("batteries are unknown until measured or full");
    worker.wait_for_line("ready:");
    // Robot 0 was silent longest: it has no place among two.
    let mut source = arena.source("robots");
    let mut seq = 100;
    eventually("a robot without account is unknown", || {
        source.send(&[steady(0, seq, clock::monotonic_ns())]);
        seq += 1;
        bounds(&arena, 0).is_some_and(|(lo, hi)| lo == 0.0 && hi > 0.99)
    });
    source.leave();
    worker.stop();
    arena.configure(&of(6));
    let mut worker = arena.worker();
    report(&arena, 0..6);
    worker.stop();
    assert_eq!(bounds(&arena, 0).map(|(lo, _)| lo), Some(0.0));
    assert!((1..6).all(|robot| is_known(bounds(&arena, robot))), "they were in the file");
}

/// The file that the worker saves by default, once there is one.
fn file(arena: &Arena) -> Option<Value> {
    let entries = std::fs::read_dir(arena.state().join("joulebus")).ok()?;
    let mut files = entries.flatten().map(|entry| entry.path());
    let path = files.find(|path| path.extension().is_some_and(|ending| ending == "json"))?;
    serde_json::from_str(&std::fs::read_to_string(path).ok()?).ok()
}

/// Its generation and states of charge.
fn saved(arena: &Arena) -> Option<(u64, Vec<f64>)> {
    let file = file(arena)?;
    let robots = file["ledger"]["robots"].as_object()?.values();
    let socs: Option<Vec<f64>> = robots.map(|robot| robot["battery"]["soc"].as_f64()).collect();
    Some((file["generation"].as_u64()?, socs?))
}

/// Number of errors of the energy over 1 s in it.
fn remembered(arena: &Arena) -> Option<f64> {
    let file = file(arena)?;
    let classes = file["ledger"]["errors"][0]["seen"]["classes"][0].as_array()?;
    classes.iter().map(Value::as_f64).sum()
}

#[test]
fn a_killed_worker_saves_batteries_by_default_and_the_next_one_does_not_fill_them() {
    let arena = Arena::new(&setup());
    let mut controller = arena.controller("controller", 0, ROBOTS, 50.0);
    let mut worker = arena.worker();
    eventually("all robots have drawn a twentieth, and their energy was off", || {
        remembered(&arena).is_some_and(|errors| errors > 2.0)
            && saved(&arena).is_some_and(|(_, socs)| {
                socs.len() == ROBOTS as usize && socs.iter().all(|soc| *soc < 0.95)
            })
    });
    assert_eq!(worker.kill().signal(), Some(9));
    let (generation, before) = saved(&arena).expect("it was there");
    let errors = remembered(&arena).expect("they were there");
    let _worker = arena.worker();
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
    // Few enough that none has faded, and none is forgotten.
    assert!(remembered(&arena).is_some_and(|after| after >= errors && errors < 200.0));
    controller.kill();
}

#[test]
fn a_fleet_without_batteries_saves_nothing_by_default() {
    let arena = Arena::new(&Setup { platform: "builtin:rover", more: String::new(), ..setup() });
    let mut worker = arena.worker();
    worker.stop();
    assert!(!arena.state().exists());
}
