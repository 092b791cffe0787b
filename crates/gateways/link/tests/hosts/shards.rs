//! A fleet that is split over two workers on two hosts, with robots on a third and planners on a
//! fourth.

use std::collections::BTreeSet;

use joulebus_testkit::{Child, eventually};
use serde_json::Value;

use crate::host::{
    Host, disturbances, free_address, has_lost_edge, is_asked_by, silences, undisturbed,
};
use crate::planner::Frame;

const LISTS: &str = "[[shard]]\nname = \"north\"\nworkers = [\"north-1\"]\nrobots = [\"0-4\"]\n\
    [[shard]]\nname = \"south\"\nworkers = [\"south-1\"]\nrobots = [\"5-9\"]\n";

/// The four hosts, and the programs on them.
struct Fleet {
    north: Host,
    south: Host,
    edge: Host,
    desk: Host,
    addresses: [String; 2],
}

impl Fleet {
    fn new(shards: &str) -> Self {
        let fleet = Self {
            north: Host::new(),
            south: Host::new(),
            edge: Host::new(),
            desk: Host::new(),
            addresses: [free_address(), free_address()],
        };
        for host in [&fleet.north, &fleet.south, &fleet.edge, &fleet.desk] {
            host.write("shards.toml", shards);
        }
        fleet
    }

    /// The file of a worker's link.
    fn of_worker(&self, name: &str, at: usize) -> String {
        let address = &self.addresses[at];
        format!(
            "name = \"{name}\"\nshards = \"shards.toml\"\n[network]\nlisten = [\"{address}\"]\nunencrypted = true\n\
             [worker]\n[[worker.take]]\nfrom = \"edge\"\n"
        )
    }

    /// The file of another host's link.
    fn of_other(&self, name: &str, sides: &str) -> String {
        let addresses = &self.addresses;
        format!(
            "name = \"{name}\"\nshards = \"shards.toml\"\n[network]\nconnect = {addresses:?}\nunencrypted = true\n{sides}"
        )
    }

    fn links(&self) -> [Child; 4] {
        [
            self.north.link(&self.of_worker("north-1", 0)),
            self.south.link(&self.of_worker("south-1", 1)),
            self.edge.link(&self.of_other("edge", "[samples]\n")),
            self.desk.link(&self.of_other("desk", "[follow]\n")),
        ]
    }
}

fn with_power(frame: &Frame) -> BTreeSet<u32> {
    let known = frame.rows.iter().filter(|row| row.has_power);
    known.map(|row| row.robot).collect()
}

fn robots(frame: &Frame) -> Vec<u32> {
    let mut robots: Vec<u32> = frame.rows.iter().map(|row| row.robot).collect();
    robots.sort_unstable();
    robots
}

fn number(report: &Value, key: &str) -> u64 {
    report[key].as_u64().unwrap()
}

/// True if a question about four robots is answered with yes for each.
fn is_answered(host: &Host, words: &[&str]) -> bool {
    let words = [words, &["--format", "json"]].concat();
    let ended = Child::spawn("ask", host.joulebus(&words)).wait();
    if ended.code() != Some(0) {
        return false;
    }
    let report = ended.json();
    let answers = report["answers"].as_array().unwrap();
    answers.len() == 4 && answers.iter().all(|answer| answer["verdict"] == "yes")
}

#[test]
fn planners_see_one_fleet_and_each_worker_has_its_own_robots_and_all_samples_are_accounted_for() {
    for shards in [LISTS.to_owned(), LISTS.replace("robots", "# robots")] {
        undisturbed(|| one_fleet(&shards));
    }
}

/// Returns the disturbances of its links.
fn one_fleet(shards: &str) -> u64 {
    let fleet = Fleet::new(shards);
    let workers = [fleet.north.worker(), fleet.south.worker()];
    let [north, south, edge, desk] = fleet.links();
    for name in ["north-1", "south-1"] {
        // Samples published before the request are not sent.
        is_asked_by(&edge, name);
    }
    let words = ["--format", "json", "--robots", "10"];
    let mut source = fleet.edge.robots(&words);
    let mut planner = fleet.desk.planner();
    let all: BTreeSet<u32> = (0..10).collect();
    let (mut whole, mut last) = (0, (0, 0));
    while whole < 30 {
        let frame = planner.frame();
        let robots = robots(&frame);
        let distinct: BTreeSet<u32> = robots.iter().copied().collect();
        assert_eq!(distinct.len(), robots.len(), "{robots:?}");
        assert!((frame.epoch, frame.tick) > last, "{frame:?}");
        assert!(frame.sent_ns <= frame.read_ns);
        last = (frame.epoch, frame.tick);
        whole += u32::from(with_power(&frame) == all);
    }
    planner.leave();
    // Compares robots of both shards. On a busy machine a frame may be stale now and then.
    let words = ["ask", "--rank", "1,8,4,6", "--idle", "5"];
    while !is_answered(&fleet.desk, &words) {}
    let source = source.end();
    let sent = number(&source.json(), "samples_sent");
    let hosts = [&fleet.north, &fleet.south];
    let known = || hosts.iter().map(|host| host.known_samples()).sum::<Option<u64>>();
    // The last samples are unknown if they were lost with their link.
    let is_silent = || has_lost_edge(&north) || has_lost_edge(&south);
    eventually("all samples are accounted for", || known() == Some(sent) || is_silent());
    let mut all_disturbances = 0;
    // End receivers before their senders: the end of a sender then counts as no silence.
    for mut link in [desk, north, south, edge] {
        let ended = link.end();
        let report = ended.json();
        for taken in report["taken"].as_array().unwrap() {
            let is_whole = taken["repeated"] == 0 && taken["other_runs"] == 0;
            assert!(silences(taken) > 0 || is_whole, "{ended:?}");
            assert_eq!(taken["refused"], serde_json::json!({}), "{ended:?}");
            all_disturbances += disturbances(taken);
        }
    }
    let reports = workers.map(|mut worker| worker.end().json());
    let (mut known, mut accepted) = (0, Vec::new());
    for report in &reports {
        let dropped = report["samples_dropped"].as_object().unwrap().values();
        known += dropped.filter_map(Value::as_u64).sum::<u64>();
        accepted.push(number(report, "samples_accepted"));
    }
    known += accepted.iter().sum::<u64>();
    assert!(all_disturbances > 0 || known == sent, "{known} of {sent}: {reports:?}");
    assert!(accepted.iter().all(|count| *count > 0), "{accepted:?}");
    all_disturbances
}

#[test]
fn every_n_th_frame_of_several_shards_has_all_their_robots_whenever_each_sends_its_own() {
    let fleet = Fleet::new(LISTS);
    // Ticks count from the worker's start, so the two workers tick at different times.
    let _north = fleet.north.worker();
    std::thread::sleep(std::time::Duration::from_millis(90));
    let _south = fleet.south.worker();
    let [_of_north, _of_south, _of_edge, mut of_desk] = fleet.links();
    of_desk.end();
    let thinned = fleet.of_other("desk", "[follow]\nevery = 8\n");
    let _of_desk = fleet.desk.link(&thinned);
    let _source = fleet.edge.robots(&["--robots", "10"]);
    let (mut near, mut planner) = (fleet.north.planner(), fleet.desk.planner());
    let period_ns = near.frame().period_ns;
    near.leave();
    let all: BTreeSet<u32> = (0..10).collect();
    let (mut whole, mut parts) = (0, 0);
    while whole < 25 {
        let frame = planner.frame();
        assert_eq!(frame.period_ns, 8 * period_ns);
        match with_power(&frame) == all {
            true => whole += 1,
            // Frames of the start-up, however long it takes.
            false if whole == 0 => {}
            // A busy machine may cause partial frames.
            false => parts += 1,
        }
    }
    assert!(parts < 25, "{parts} frames without some robots");
}

#[test]
fn when_a_shard_ends_its_robots_are_known_to_be_stale_and_the_others_go_on() {
    let fleet = Fleet::new(LISTS);
    let (mut north, mut south) = (fleet.north.worker(), fleet.south.worker());
    let mut links = fleet.links();
    let _source = fleet.edge.robots(&["--robots", "10"]);
    let mut planner = fleet.desk.planner();
    let (all, of_north) = ((0..10).collect(), (0..5).collect());
    let until = |planner: &mut crate::planner::Reader, wanted: &BTreeSet<u32>| loop {
        let frame = planner.frame();
        if with_power(&frame) == *wanted {
            return frame;
        }
    };
    let first = until(&mut planner, &all);
    south.end();
    links[3].wait_for_line("the worker of south-1 has ended");
    let frame = until(&mut planner, &of_north);
    // The shard's robots are still listed, without a forecast. The fleet is the same run.
    assert_eq!(robots(&frame), (0..10).collect::<Vec<u32>>());
    assert_eq!(frame.epoch, first.epoch);
    south = fleet.south.worker();
    assert_eq!(until(&mut planner, &all).epoch, first.epoch);
    // The last worker that is connected: now the fleet has ended.
    south.end();
    until(&mut planner, &of_north);
    north.end();
    assert_eq!(planner.gone(), "Ended");
}

#[test]
fn a_check_states_which_robots_each_shard_has_and_for_which_the_link_sends() {
    let fleet = Fleet::new(&LISTS.replace("0-4", "0-2").replace("5-9", "3-9"));
    let text = fleet.of_worker("south-1", 1);
    let mut command = fleet.south.link_command(&text);
    command.arg("--check");
    let checked = Child::spawn("check", command).wait();
    assert_eq!(checked.code(), Some(0), "{checked:?}");
    let report = checked.json();
    assert_eq!(report["shards"], serde_json::json!({"north": 3, "south": 7}));
    assert_eq!(report["leads"], "south");
}

#[test]
fn hosts_with_different_files_of_shards_refuse_each_other() {
    let fleet = Fleet::new(LISTS);
    fleet.desk.write("shards.toml", &LISTS.replace("0-4", "0-3").replace("5-9", "4-9"));
    let _worker = fleet.north.worker();
    let mut base = fleet.north.link(&fleet.of_worker("north-1", 0));
    let _desk = fleet.desk.link(&fleet.of_other("desk", "[follow]\n"));
    base.wait_for_line("its file of shards is another one");
    let ended = base.end();
    assert_eq!(ended.code(), Some(3), "{ended:?}");
    assert!(ended.json()["refused"]["other shards"].as_u64() >= Some(1), "{ended:?}");
}
