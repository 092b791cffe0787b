//! Two hosts on one machine.

use std::collections::BTreeMap;

use joulebus_testkit::{Child, Ended, MemoryGroup, as_in_docker, eventually, remove};
use serde_json::Value;

use crate::host::{
    ATTEMPTS, FOLLOW, Host, SAMPLES, disturbances, free_address, has_lost_edge, is_asked_by,
    of_other, of_worker, silences, undisturbed,
};
use crate::planner::Reader;

fn ended(mut child: Child) -> Ended {
    child.end()
}

#[test]
fn planners_elsewhere_read_the_bits_of_the_worker_and_nothing_looks_fresher_than_it_is() {
    undisturbed(read_elsewhere);
}

/// Frames that may precede a good clock offset: each round trip bounds it, and the first ones may
/// be slow.
const EARLY: usize = 30;

/// Returns the disturbances of the worker's link.
fn read_elsewhere() -> u64 {
    let (here, there) = (Host::new(), Host::new());
    let address = free_address();
    let worker = here.worker();
    let robots = here.robots(&["--robots", "5"]);
    let base = here.link(&of_worker(&address, &[]));
    let desk = there.link(&of_other("desk", &address, FOLLOW));
    let (mut near, mut far) = (here.planner(), there.planner());
    let (mut own, mut came) = (BTreeMap::new(), BTreeMap::new());
    let mut both = Vec::new();
    while both.len() < EARLY + 60 {
        let frame = near.frame();
        own.insert(frame.tick, frame);
        let frame = far.frame();
        assert!(frame.sent_ns <= frame.read_ns);
        came.insert(frame.tick, frame);
        let in_both = came.keys().filter(|tick| own.contains_key(*tick));
        both = in_both.copied().collect();
    }
    for (at, tick) in both.into_iter().enumerate() {
        let (frame, own) = (&came[&tick], &own[&tick]);
        assert_eq!((frame.epoch, frame.rows.len()), (own.epoch, own.rows.len()));
        for (row, own) in frame.rows.iter().zip(&own.rows) {
            assert_eq!(row.bits, own.bits, "tick {tick}");
            let older_ns = own.stamp_ns.checked_sub(row.stamp_ns);
            let older_ns = older_ns.expect("never younger than it is");
            assert!(at < EARLY || older_ns < 100_000_000, "{older_ns}");
            assert_eq!(own.target_ns - row.target_ns, older_ns);
        }
    }
    near.leave();
    far.leave();
    // Programs that need more than forecasts. Each times out after 3 s.
    eventually("it is watched", || there.known_samples().is_some());
    eventually("it is answered", || {
        let asked = ["ask", "--robot", "2", "--idle", "3", "--format", "json"];
        let asked = Child::spawn("ask", there.joulebus(&asked)).wait();
        asked.code() == Some(0) && asked.json()["answers"][0]["verdict"] == "yes"
    });
    let desk = ended(desk);
    let taken = desk.json()["taken"][0].clone();
    assert!(taken["frames"].as_u64().unwrap() > 60, "{taken}");
    assert_eq!(taken["repeated"], 0, "{taken}");
    let uncertainty_s = taken["clock_uncertainty_s"].as_f64();
    let is_known = uncertainty_s.is_some_and(|uncertainty_s| uncertainty_s < 0.02);
    assert!(silences(&taken) > 0 || is_known, "{taken}");
    let base = ended(base);
    assert_eq!(base.json()["given"][0]["to"], "desk");
    for child in [robots, worker] {
        assert_eq!(ended(child).code(), Some(0));
    }
    assert_eq!((here.stale_files(), there.stale_files()), (vec![], vec![]));
    disturbances(&taken)
}

#[test]
fn samples_of_another_host_reach_the_worker_under_their_own_identity_and_all_are_accounted_for() {
    undisturbed(samples_of_another_host);
}

/// Returns the disturbances of the robots' link.
fn samples_of_another_host() -> u64 {
    let (here, there) = (Host::new(), Host::new());
    let address = free_address();
    let worker = here.worker();
    let base = here.link(&of_worker(&address, &["edge"]));
    let edge = there.link(&of_other("edge", &address, &format!("{SAMPLES}{FOLLOW}")));
    // Samples published before the request are not sent.
    is_asked_by(&edge, "base");
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
    // A robots' host also reads forecasts of its own robots.
    let mut planner = there.planner();
    let mut known = 0;
    while known < 100 {
        known += planner.frame().rows.iter().filter(|row| row.has_power).count();
    }
    planner.leave();
    let robots = robots.wait();
    assert_eq!(robots.code(), Some(0), "{robots:?}");
    let sent = robots.json()["samples_sent"].as_u64().unwrap();
    // The last samples are unknown if they were lost with their link.
    eventually("all samples are accounted for", || {
        here.known_samples() == Some(sent) || has_lost_edge(&base)
    });
    // End the base first: its end then counts as no silence.
    let base = ended(base);
    ended(edge);
    let taken = base.json()["taken"][0].clone();
    let disturbances = disturbances(&taken);
    let report = ended(worker).json();
    let dropped: u64 = report["samples_dropped"]
        .as_object()
        .unwrap()
        .values()
        .filter_map(serde_json::Value::as_u64)
        .sum();
    let accepted = report["samples_accepted"].as_u64().unwrap();
    assert!(disturbances > 0 || accepted > 200, "{report}");
    assert!(disturbances > 0 || accepted + dropped == sent, "{report}");
    assert_eq!((here.stale_files(), there.stale_files()), (vec![], vec![]));
    disturbances
}

#[test]
fn sources_of_one_name_on_two_hosts_replace_each_other_no_more_than_their_robots_do() {
    let (here, one, other) = (Host::new(), Host::new(), Host::new());
    let address = free_address();
    let worker = here.worker();
    let base = here.link(&of_worker(&address, &["edge-1", "edge-2"]));
    let links = [(&one, "edge-1"), (&other, "edge-2")]
        .map(|(host, name)| host.link(&of_other(name, &address, SAMPLES)));
    let source = |host: &Host, first: &str| {
        let words = ["--name", "bridge", "--robots", "3", "--first-robot", first];
        host.robots(&words)
    };
    let sources = [source(&one, "0"), source(&other, "5")];
    let mut planner = here.planner();
    let mut both = 0;
    while both < 60 {
        let frame = planner.frame();
        let known = frame.rows.iter().filter(|row| row.has_power);
        let mut known: Vec<u32> = known.map(|row| row.robot).collect();
        known.sort_unstable();
        both += u32::from(known == [0, 1, 2, 5, 6, 7]);
    }
    planner.leave();
    sources.into_iter().for_each(|source| drop(ended(source)));
    links.into_iter().for_each(|link| drop(ended(link)));
    ended(base);
    let report = ended(worker).json();
    let of_older_runs = &report["samples_dropped"]["OldEpoch"];
    assert!(of_older_runs.as_u64().unwrap_or(0) == 0, "{report}");
}

#[test]
fn links_and_workers_start_in_any_order_and_one_that_is_not_there_keeps_none_from_another() {
    let [first, second, there] = [Host::new(), Host::new(), Host::new()];
    let [one, other] = [free_address(), free_address()];
    let text = format!(
        "name = \"desk\"\n[network]\nconnect = [\"{one}\", \"{other}\"]\nunencrypted = true\n\
         {SAMPLES}{FOLLOW}"
    );
    let desk = there.link(&text);
    // No router answers for longer than an attempt at all of them may take, and that is logged.
    eventually("it is logged that nobody answers", || {
        let errors = desk.errors();
        errors.contains("nothing has come from base so far")
            && errors.contains("base has not asked")
    });
    for (host, address) in [(&first, &other), (&second, &one)] {
        let worker = host.worker();
        let base = host.link(&of_worker(address, &["desk"]));
        let robots = there.robots(&["--robots", "2"]);
        let mut planner = there.planner();
        planner.fresh();
        planner.leave();
        for child in [robots, base, worker] {
            let _ = ended(child);
        }
    }
    let _ = ended(desk);
}

/// `ends` starts a part of the fleet, waits until the planner reads, and ends the part. Repeated
/// until the planner sees the expected end: a link that gets no processor for a second counts as
/// gone before that, as promised.
fn gone_as(planner: &mut Reader, expected: &str, mut ends: impl FnMut(&mut Reader)) {
    for _ in 0..ATTEMPTS {
        ends(planner);
        let how = planner.gone();
        if how == expected {
            return;
        }
        assert_eq!(how, "Unreachable", "expected {expected}");
    }
    panic!("{ATTEMPTS} times unreachable, expected {expected}");
}

#[test]
fn planners_elsewhere_learn_how_a_worker_ended_and_read_the_next_one_without_joining_again() {
    let (here, there) = (Host::new(), Host::new());
    let address = free_address();
    let mut worker = Some(here.worker());
    let _robots = here.robots(&["--robots", "3"]);
    let mut base = here.link(&of_worker(&address, &[]));
    let mut desk = Some(there.link(&of_other("desk", &address, FOLLOW)));
    let mut planner = there.planner();
    // The worker's process is killed.
    gone_as(&mut planner, "Ended", |planner| {
        let mut worker = worker.take().unwrap_or_else(|| here.worker());
        planner.fresh();
        worker.kill();
    });
    // It ends by itself.
    gone_as(&mut planner, "Ended", |planner| {
        let mut worker = here.worker();
        planner.fresh();
        assert_eq!(worker.end().code(), Some(0));
    });
    let _worker = here.worker();
    planner.fresh();
    // The link of the worker's host is killed. The worker may still run.
    base.kill();
    assert_eq!(planner.gone(), "Unreachable");
    let mut base = here.link(&of_worker(&address, &[]));
    planner.fresh();
    // The link is asked to end.
    assert_eq!(base.end().code(), Some(0));
    assert_eq!(planner.gone(), "Unreachable");
    let _base = here.link(&of_worker(&address, &[]));
    // The link of this host is killed.
    gone_as(&mut planner, "Exited", |planner| {
        let begun = || there.link(&of_other("desk", &address, FOLLOW));
        let mut desk = desk.take().unwrap_or_else(begun);
        planner.fresh();
        desk.kill();
    });
    gone_as(&mut planner, "Ended", |planner| {
        let mut desk = there.link(&of_other("desk", &address, FOLLOW));
        planner.fresh();
        assert!(desk.end().code().is_some());
    });
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
    let (mut near, mut planner) = (here.planner(), there.planner());
    let period_ns = near.frame().period_ns;
    let (mut ticks, mut last_read_ns) = (Vec::new(), 0);
    // Without twenty pairs in a row that lost nothing, no ticks are consecutive.
    while ticks.len() < 8 || !(ticks.windows(2).any(|pair| pair[1] == pair[0] + 1)) {
        assert!(ticks.len() < 20, "{ticks:?}");
        let frame = planner.frame();
        // A frame is stale if it is older than two periods of the requested frames.
        assert_eq!(frame.period_ns, 5 * period_ns);
        let mut robots = frame.rows.iter().map(|row| row.robot);
        assert!(robots.all(|robot| [1, 4, 5, 6].contains(&robot)), "{frame:?}");
        ticks.push(frame.tick);
        last_read_ns = frame.read_ns;
    }
    // The worker sends every fifth of its frames. A later one has a later time.
    let mut later = near.frame();
    while later.sent_ns < last_read_ns {
        later = near.frame();
    }
    let last = ticks[ticks.len() - 1];
    assert!(later.tick / 5 >= last, "{ticks:?}, then {later:?}");
    near.leave();
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
    let refusal = "already has a worker on another host: the link here stands in for it";
    assert!(refused.errors().contains(refusal), "{refused:?}");
    assert!(!refused.errors().contains("kill"), "{refused:?}");
    let _robots = here.robots(&["--robots", "2"]);
    let mut doctor = Value::Null;
    eventually("the doctor tells what the host hears", || {
        doctor =
            Child::spawn("doctor", there.joulebus(&["doctor", "--format", "json"])).wait().json();
        doctor.to_string().contains("hears forecasts of 2 robots")
    });
    let second = Child::spawn("link", here.link_command(&of_other("x", &address, FOLLOW))).wait();
    assert_eq!(second.code(), Some(1), "{second:?}");
    assert!(second.errors().contains("already has a worker"), "{second:?}");
}

#[test]
fn links_need_nothing_that_docker_forbids() {
    let (here, there) = (Host::new(), Host::new());
    let address = free_address();
    let _worker = here.worker();
    let commands = [
        here.link_command(&of_worker(&address, &["edge"])),
        there.link_command(&of_other("edge", &address, &format!("{SAMPLES}{FOLLOW}"))),
    ];
    let Some(links) = commands.iter().map(as_in_docker).collect::<Option<Vec<_>>>() else {
        return;
    };
    let links: Vec<_> = links.into_iter().map(|command| Child::spawn("link", command)).collect();
    let _robots = there.robots(&["--robots", "2"]);
    let mut planner = there.planner();
    planner.fresh_sample();
    planner.leave();
    for link in links {
        assert_eq!(ended(link).json()["fleet"], "lab");
    }
}

#[test]
fn the_next_link_works_when_the_kernel_has_killed_one_for_memory() {
    let Some(group) = MemoryGroup::new(160 << 20) else { return };
    let (here, there) = (Host::new(), Host::new());
    let address = free_address();
    let _worker = here.worker();
    let _robots = here.robots(&["--robots", "2"]);
    let mut desk = there.link(&of_other("desk", &address, FOLLOW));
    let mut planner = there.planner();
    for is_killed in [true, false] {
        let command = group.first_to_die(&here.link_command(&of_worker(&address, &[])));
        let mut base = Child::spawn("link", command);
        planner.fresh_sample();
        if is_killed {
            group.exhaust();
            assert_eq!(base.wait().signal(), Some(9));
            assert_eq!(planner.gone(), "Unreachable");
        } else {
            // A busy host may lose a message.
            assert!(matches!(base.end().exit_code(), 0 | 3));
        }
    }
    planner.leave();
    desk.end();
}

#[test]
fn a_link_whose_shared_memory_is_removed_reports_it_and_exits_with_1() {
    let (here, there, address) = (Host::new(), Host::new(), free_address());
    let mut worker = here.worker();
    let mut links =
        [here.link(&of_worker(&address, &[])), there.link(&of_other("desk", &address, FOLLOW))];
    for host in [&here, &there] {
        host.stale_files().iter().for_each(|path| remove(path));
    }
    for link in &mut links {
        let ended = link.wait();
        assert!(ended.code() == Some(1) && ended.errors().contains("RemoveIPC"), "{ended:?}");
    }
    assert_eq!(worker.wait().code(), Some(1));
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
