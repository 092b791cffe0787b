//! Several fleets on the same hosts, each with its own worker.

use std::collections::BTreeSet;
use std::time::Duration;

use joulebus_bus::clock;
use joulebus_consumer::{End, Event, Subscriber};
use joulebus_testkit::{Child, eventually};
use serde_json::Value;

use crate::host::{
    FOLLOW, Host, SAMPLES, disturbances, free_address, has_lost_edge, is_asked_by, of_other,
    of_worker, undisturbed,
};

/// Robots of each fleet.
const ROBOTS: usize = 5;

/// Reads until all robots of the fleet have a forecast.
fn all_known(planner: &mut Subscriber, ids: &BTreeSet<u32>) {
    eventually("forecasts of all robots", || {
        let Event::Frame(frame) = planner.wait_next(Duration::from_secs(1)).unwrap() else {
            return false;
        };
        let known = frame.robots().iter().filter(|row| row.expected_w().is_some());
        let known: BTreeSet<u32> = known.map(|row| row.robot).collect();
        assert!(known.is_subset(ids), "{known:?} of {ids:?}");
        known == *ids
    });
}

fn ids(fleet: usize, robots: usize) -> BTreeSet<u32> {
    (fleet * robots..(fleet + 1) * robots).map(|id| id as u32).collect()
}

fn number(report: &Value, key: &str) -> u64 {
    report[key].as_u64().unwrap()
}

#[test]
fn two_fleets_share_three_hosts_and_a_planner_ranks_robots_of_both_and_all_samples_count_once() {
    undisturbed(share_hosts);
}

/// Returns the disturbances of the links.
fn share_hosts() -> u64 {
    let [bases, edges, desks] = [(); 3].map(|()| Host::of_two(ROBOTS));
    let addresses = [0, 1].map(|_| free_address());
    let mut workers = [0, 1].map(|at| bases[at].worker());
    let links = [0, 1].map(|at| {
        let address = &addresses[at];
        let base = bases[at].link(&of_worker(address, &["edge"]));
        let edge = edges[at].link(&of_other("edge", address, SAMPLES));
        let desk = desks[at].link(&of_other("desk", address, FOLLOW));
        // Samples published before the request are not sent.
        is_asked_by(&edge, "base");
        [desk, base, edge]
    });
    let words = ["--format", "json", "--robots", &ROBOTS.to_string()];
    let sources = edges.each_ref().map(|edge| edge.robots(&words));
    // One process reads both fleets.
    let mut planners = desks.each_ref().map(|desk| Subscriber::connect(desk.config()).unwrap());
    for (at, planner) in planners.iter_mut().enumerate() {
        all_known(planner, &ids(at, ROBOTS));
    }
    let both = desks[1].config().display().to_string();
    let words = ["ask", "--rank", "1,8,4,6", "--idle", "5", "--config", &both, "--format", "json"];
    let mut answers = Vec::new();
    eventually("the robots of both fleets are ranked", || {
        let asked = Child::spawn("ask", desks[0].joulebus(&words)).wait();
        if asked.code() == Some(0) {
            answers = asked.json()["answers"].as_array().unwrap().clone();
        }
        answers.len() == 4 && answers.iter().all(|answer| answer["verdict"] == "yes")
    });
    let mean_j = |answer: &Value| answer["energy"]["mean_j"].as_f64().unwrap();
    assert!(answers.is_sorted_by_key(mean_j), "{answers:?}");
    for answer in &answers {
        let fleet = if number(answer, "robot") < ROBOTS as u64 { "north" } else { "south" };
        assert_eq!(answer["fleet"], fleet, "{answer}");
    }
    let sent = sources.map(|mut source| number(&source.end().json(), "samples_sent"));
    for (at, sent) in sent.into_iter().enumerate() {
        // The last samples are unknown if they were lost with their link.
        let is_silent = || has_lost_edge(&links[at][1]);
        eventually("all samples are accounted for", || {
            bases[at].known_samples() == Some(sent) || is_silent()
        });
    }
    // The end of one fleet's worker is not that of the other.
    workers[1].end();
    eventually("the planner of that fleet learns it", || {
        let event = planners[1].wait_next(Duration::from_secs(1)).unwrap();
        matches!(event, Event::Gone(End::Ended))
    });
    let now_ns = clock::monotonic_ns();
    eventually("the other fleet goes on", || {
        let event = planners[0].wait_next(Duration::from_secs(1)).unwrap();
        matches!(event, Event::Frame(frame) if frame.header().sent_ns > now_ns)
    });
    let mut all_disturbances = 0;
    for mut link in links.into_iter().flatten() {
        let ended = link.end();
        for taken in ended.json()["taken"].as_array().unwrap() {
            assert_eq!(taken["refused"], serde_json::json!({}), "{ended:?}");
            all_disturbances += disturbances(taken);
        }
    }
    all_disturbances
}

/// Robots of each large fleet. Programs that are not optimised have a tenth of them.
const LARGE: usize = if cfg!(debug_assertions) { 5_000 } else { 50_000 };

/// Two large fleets on one host. `JOULEBUS_ROBOTS` states another number of robots of each.
#[test]
#[ignore = "prints figures, and needs both processors"]
fn two_fleets_of_fifty_thousand_robots() {
    let count = std::env::var("JOULEBUS_ROBOTS").map_or(LARGE, |count| count.parse().unwrap());
    let hosts = Host::of_two(count);
    let workers = hosts.each_ref().map(Host::worker);
    let sources = hosts.each_ref().map(|host| host.robots(&["--robots", &count.to_string()]));
    let mut planners = hosts.each_ref().map(|host| Subscriber::connect(host.config()).unwrap());
    for (at, planner) in planners.iter_mut().enumerate() {
        all_known(planner, &ids(at, count));
    }
    std::thread::sleep(Duration::from_secs(20));
    drop(planners);
    for mut child in sources.into_iter().chain(workers) {
        let pid = child.pid();
        let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
        let memory = status.lines().find(|line| line.starts_with("VmRSS"));
        println!("figure: {count} robots, {memory:?}: {}", child.end().text());
    }
}
