//! Two hosts on one machine.

use std::collections::BTreeMap;
use std::time::Duration;

use joulebus_test_processes::{Child, Ended};

use crate::host::{FOLLOW, Host, SAMPLES, free_address, of_other, of_worker};

fn ended(mut child: Child) -> Ended {
    child.end()
}

#[test]
fn planners_elsewhere_read_the_bits_of_the_worker_and_nothing_looks_fresher_than_it_is() {
    let (here, there) = (Host::new(), Host::new());
    let address = free_address();
    let worker = here.worker();
    let robots = here.robots(&["--robots", "5"]);
    let base = here.link(&of_worker(&address, &[]));
    let desk = there.link(&of_other("desk", &address, FOLLOW));
    let (mut near, mut far) = (here.planner(), there.planner());
    let (mut own, mut came) = (BTreeMap::new(), BTreeMap::new());
    let mut both = Vec::new();
    while both.len() < 60 {
        let frame = near.frame();
        own.insert(frame.tick, frame);
        let frame = far.frame();
        assert!(frame.sent_ns <= frame.read_ns);
        came.insert(frame.tick, frame);
        let in_both = came.keys().filter(|tick| own.contains_key(*tick));
        both = in_both.copied().collect();
    }
    for tick in both {
        let (frame, own) = (&came[&tick], &own[&tick]);
        assert_eq!((frame.epoch, frame.rows.len()), (own.epoch, own.rows.len()));
        for (row, own) in frame.rows.iter().zip(&own.rows) {
            assert_eq!(row.bits, own.bits, "tick {tick}");
            let older_ns = own.stamp_ns.checked_sub(row.stamp_ns);
            let older_ns = older_ns.expect("never younger than it is");
            assert!(older_ns < 100_000_000, "{older_ns}");
            assert_eq!(own.target_ns - row.target_ns, older_ns);
        }
    }
    near.leave();
    far.leave();
    // Programs that need more than forecasts.
    let watched = Child::spawn(
        "watch",
        there.joulebus(&["watch", "--once", "--format", "json"]),
    )
    .wait();
    assert_eq!(watched.code(), Some(0), "{watched:?}");
    let asked = ["ask", "--robot", "2", "--idle", "3", "--format", "json"];
    let asked = Child::spawn("ask", there.joulebus(&asked)).wait();
    assert_eq!(asked.json()["answers"][0]["verdict"], "yes", "{asked:?}");
    let desk = ended(desk);
    let taken = desk.json()["taken"][0].clone();
    assert!(taken["frames"].as_u64().unwrap() > 60, "{taken}");
    assert_eq!(
        (taken["lost"].as_u64(), taken["repeated"].as_u64()),
        (Some(0), Some(0))
    );
    assert!(
        taken["clock_uncertainty_s"].as_f64().unwrap() < 0.02,
        "{taken}"
    );
    let base = ended(base);
    assert_eq!(base.json()["given"][0]["to"], "desk");
    for child in [robots, worker] {
        assert_eq!(ended(child).code(), Some(0));
    }
    assert_eq!((here.stale_files(), there.stale_files()), (vec![], vec![]));
}

#[test]
fn samples_of_another_host_reach_the_worker_under_their_own_identity_and_all_are_accounted_for() {
    let (here, there) = (Host::new(), Host::new());
    let address = free_address();
    let worker = here.worker();
    let base = here.link(&of_worker(&address, &["edge"]));
    let edge = there.link(&of_other("edge", &address, &format!("{SAMPLES}{FOLLOW}")));
    let mut robots = there.robots(&[
        "--format",
        "json",
        "--robots",
        "4",
        "--duration",
        "4",
        "--name",
        "edge-robots",
    ]);
    // A robots' host reads forecasts of its own robots, too.
    let mut planner = there.planner();
    let mut known = 0;
    while known < 100 {
        known += planner
            .frame()
            .rows
            .iter()
            .filter(|row| row.has_power)
            .count();
    }
    planner.leave();
    let robots = robots.wait();
    assert_eq!(robots.code(), Some(0), "{robots:?}");
    let sent = robots.json()["samples_sent"].as_u64().unwrap();
    std::thread::sleep(Duration::from_millis(300));
    ended(edge);
    let base = ended(base);
    assert_eq!(
        base.json()["taken"][0]["lost"].as_u64(),
        Some(0),
        "{base:?}"
    );
    let report = ended(worker).json();
    let dropped: u64 = report["samples_dropped"]
        .as_object()
        .unwrap()
        .values()
        .filter_map(serde_json::Value::as_u64)
        .sum();
    let accepted = report["samples_accepted"].as_u64().unwrap();
    assert!(accepted > 200, "{report}");
    assert_eq!(accepted + dropped, sent, "{report}");
    assert_eq!((here.stale_files(), there.stale_files()), (vec![], vec![]));
}

#[test]
fn planners_elsewhere_learn_how_a_worker_ended_and_read_the_next_one_without_joining_again() {
    let (here, there) = (Host::new(), Host::new());
    let address = free_address();
    let mut worker = here.worker();
    let _robots = here.robots(&["--robots", "3"]);
    let mut base = here.link(&of_worker(&address, &[]));
    let mut desk = there.link(&of_other("desk", &address, FOLLOW));
    let mut planner = there.planner();
    planner.fresh();
    // The worker's process is killed.
    worker.kill();
    assert_eq!(planner.gone(), "Ended");
    let mut worker = here.worker();
    planner.fresh();
    // It ends by itself.
    assert_eq!(worker.end().code(), Some(0));
    assert_eq!(planner.gone(), "Ended");
    let _worker = here.worker();
    planner.fresh();
    // The link of its host is killed: the worker may run.
    base.kill();
    assert_eq!(planner.gone(), "Unreachable");
    let mut base = here.link(&of_worker(&address, &[]));
    planner.fresh();
    // It is asked to end.
    assert_eq!(base.end().code(), Some(0));
    assert_eq!(planner.gone(), "Unreachable");
    let _base = here.link(&of_worker(&address, &[]));
    planner.fresh();
    // The link of this host is killed.
    desk.kill();
    assert_eq!(planner.gone(), "Exited");
    let mut desk = there.link(&of_other("desk", &address, FOLLOW));
    planner.fresh();
    assert!(desk.end().code().is_some());
    assert_eq!(planner.gone(), "Ended");
    let _desk = there.link(&of_other("desk", &address, FOLLOW));
    planner.fresh();
    assert!(planner.fresh().runs >= 5);
}

#[test]
fn a_receiver_gets_the_ticks_and_robots_that_it_asks_for() {
    let (here, there) = (Host::new(), Host::new());
    let address = free_address();
    let _worker = here.worker();
    let _robots = here.robots(&["--robots", "8"]);
    let _base = here.link(&of_worker(&address, &[]));
    let follow = format!("{FOLLOW}every = 5\nrobots = [1, \"4-6\"]\nservices = []\n");
    let _desk = there.link(&of_other("desk", &address, &follow));
    let mut planner = there.planner();
    for _ in 0..8 {
        let frame = planner.frame();
        assert_eq!(frame.tick % 5, 0);
        let mut robots = frame.rows.iter().map(|row| row.robot);
        assert!(
            robots.all(|robot| [1, 4, 5, 6].contains(&robot)),
            "{frame:?}"
        );
    }
}

#[test]
fn a_host_has_a_worker_or_a_link_in_its_place_and_the_second_is_refused() {
    let (here, there) = (Host::new(), Host::new());
    let address = free_address();
    let _base = here.link(&of_worker(&address, &[]));
    let _worker = here.worker();
    let _desk = there.link(&of_other("desk", &address, FOLLOW));
    let refused = Child::spawn("run", there.joulebus(&["run"])).wait();
    assert_eq!(refused.code(), Some(1), "{refused:?}");
    assert!(
        refused.errors().contains("already has a worker"),
        "{refused:?}"
    );
    let second = Child::spawn("link", here.link_command(&of_other("x", &address, FOLLOW))).wait();
    assert_eq!(second.code(), Some(1), "{second:?}");
    assert!(
        second.errors().contains("already has a worker"),
        "{second:?}"
    );
}

#[test]
fn an_address_that_is_taken_ends_a_link_with_the_reason() {
    let host = Host::new();
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("tcp/{}", listener.local_addr().unwrap());
    let refused = Child::spawn("link", host.link_command(&of_worker(&address, &[]))).wait();
    assert_eq!(refused.code(), Some(1), "{refused:?}");
    assert!(refused.errors().contains(&address), "{refused:?}");
}
