//! What a link costs beside zenoh itself: measures, and decides nothing. In a release build:
//! `cargo test --release -p joulebus-link --test hosts -- --include-ignored --nocapture speed`.

use std::collections::BTreeMap;
use std::fs;
use std::time::Duration;

use joulebus_bus::clock;
use joulebus_test_processes::{Member, send_to_test};
use zenoh::Wait as _;
use zenoh::qos::CongestionControl;

use crate::host::{FOLLOW, Host, free_address, of_other, of_worker};

const SEND: &str = "JOULEBUS_LINK_RAW_SEND";
const RECEIVE: &str = "JOULEBUS_LINK_RAW_RECEIVE";
const KEY: &str = "raw/frames";
const TICK: Duration = Duration::from_nanos(33_333_333);
/// Frames of each measurement: ten seconds.
const FRAMES: usize = 300;
const FIRST: usize = 30;

fn session(key: &str, address: &str) -> zenoh::Session {
    let mut config = zenoh::Config::default();
    config
        .insert_json5(key, &format!("[\"{address}\"]"))
        .unwrap();
    config
        .insert_json5("scouting/multicast/enabled", "false")
        .unwrap();
    zenoh::open(config).wait().unwrap()
}

/// The processes of zenoh alone: `address` and bytes of a message, or only the address.
pub(crate) fn run() {
    if let Ok(of) = std::env::var(SEND) {
        let (address, bytes) = of.split_once(' ').unwrap();
        let session = session("listen/endpoints", address);
        let publisher = session
            .declare_publisher(KEY)
            .congestion_control(CongestionControl::Drop);
        let publisher = publisher.express(true).wait().unwrap();
        send_to_test("joined");
        loop {
            let mut message = vec![0; bytes.parse().unwrap()];
            message[..8].copy_from_slice(&clock::monotonic_ns().to_le_bytes());
            publisher.put(message).wait().unwrap();
            std::thread::sleep(TICK);
        }
    }
    if let Ok(address) = std::env::var(RECEIVE) {
        let session = session("connect/endpoints", &address);
        let subscriber = session.declare_subscriber(KEY).wait().unwrap();
        send_to_test("joined");
        while let Ok(sample) = subscriber.recv() {
            let bytes = sample.payload().to_bytes();
            let sent_ns = u64::from_le_bytes(bytes[..8].try_into().unwrap());
            send_to_test(clock::monotonic_ns() - sent_ns);
        }
    }
}

/// Processor time of a process so far, in ticks of the kernel's clock (100 a second).
fn spent(pid: u32) -> u64 {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    let fields: Vec<&str> = stat.rsplit(") ").next().unwrap().split(' ').collect();
    fields[11].parse::<u64>().unwrap() + fields[12].parse::<u64>().unwrap()
}

/// Median and 99th percentile, µs.
fn spread(mut all_ns: Vec<u64>) -> (f64, f64) {
    all_ns.sort_unstable();
    let at = |share: usize| all_ns[all_ns.len() * share / 100] as f64 / 1_000.0;
    (at(50), at(99))
}

/// One-way times of zenoh alone, and the processor's share of both processes.
fn raw(bytes: usize) -> ((f64, f64), f64) {
    let address = free_address();
    let process = |key: &str, value: String| {
        let mut command = Member::command();
        command.env(key, value);
        let mut member = Member::spawn("raw", command);
        assert_eq!(member.next_line(), "joined");
        member
    };
    let sender = process(SEND, format!("{address} {bytes}"));
    let mut receiver = process(RECEIVE, address);
    let mut took_ns = Vec::new();
    let mut begin = 0;
    for at in 0..FRAMES + FIRST {
        let ns = receiver.next_line().parse().unwrap();
        if at == FIRST {
            begin = spent(sender.pid()) + spent(receiver.pid());
        }
        if at >= FIRST {
            took_ns.push(ns);
        }
    }
    let cpu = spent(sender.pid()) + spent(receiver.pid()) - begin;
    sender.kill();
    receiver.kill();
    (spread(took_ns), cpu as f64 / (FRAMES as f64 / 30.0))
}

/// One-way times of forecasts over a link, from sending by the worker to reading elsewhere, and the links' share.
fn linked(robots: usize) -> ((f64, f64), f64, u64) {
    let (here, there) = (Host::of(robots), Host::of(robots));
    let address = free_address();
    let _worker = here.worker();
    let _robots = here.robots(&["--robots", &robots.to_string()]);
    let base = here.link(&of_worker(&address, &[]));
    let mut desk = there.link(&of_other(
        "desk",
        &address,
        &format!("{FOLLOW}services = []\n"),
    ));
    let (mut near, mut far) = (here.planner(), there.planner());
    let (mut sent, mut read) = (BTreeMap::new(), BTreeMap::new());
    for _ in 0..FIRST {
        near.frame();
        far.frame();
    }
    let begin = spent(base.pid()) + spent(desk.pid());
    for _ in 0..FRAMES {
        let frame = near.frame();
        sent.insert(frame.tick, frame.sent_ns);
        let frame = far.frame();
        read.insert(frame.tick, frame.read_ns);
    }
    let cpu = spent(base.pid()) + spent(desk.pid()) - begin;
    let both = read
        .iter()
        .filter_map(|(tick, read_ns)| Some(read_ns - sent.get(tick)?));
    let took_ns: Vec<u64> = both.collect();
    assert!(took_ns.len() > FRAMES / 2, "{}", took_ns.len());
    let lost = desk.end().json()["taken"][0]["dropped"].as_u64().unwrap();
    (spread(took_ns), cpu as f64 / (FRAMES as f64 / 30.0), lost)
}

#[test]
#[ignore = "measures; run it in a release build on a quiet machine"]
fn speed_of_forecasts_over_a_link_beside_zenoh_alone() {
    for robots in [100, 1_000, 10_000] {
        for round in 1..=3 {
            let bytes = 112 + 320 + 72 * robots;
            let ((p50, p99), cpu) = raw(bytes);
            println!(
                "figure: zenoh, {robots} robots, round {round}: {bytes} bytes, one way p50 {p50:.0} µs, p99 {p99:.0} µs, {cpu:.1} % of a processor"
            );
            let ((p50, p99), cpu, dropped) = linked(robots);
            println!(
                "figure: link, {robots} robots, round {round}: one way p50 {p50:.0} µs, p99 {p99:.0} µs, {cpu:.1} % of a processor, {dropped} left out"
            );
        }
    }
}

/// A host with a config for so many robots, and the fleet's file of four shards.
fn of_shards(robots: usize) -> Host {
    let host = Host::of(robots);
    let shard = |at: usize| format!("[[shard]]\nname = \"s{at}\"\nworkers = [\"base-{at}\"]\n");
    let shards: String = (0..SHARDS).map(shard).collect();
    host.write("shards.toml", &shards);
    host
}

const SHARDS: usize = 4;

/// Robots on one host, four workers with a shard each, planners on a further one.
#[test]
#[ignore = "measures; run it in a release build on a quiet machine"]
fn speed_of_a_fleet_on_four_shards() {
    for robots in [1_000, 4_000, 10_000] {
        let hosts: Vec<Host> = (0..SHARDS).map(|_| of_shards(robots)).collect();
        let (edge, desk) = (of_shards(robots), of_shards(robots));
        let addresses: Vec<String> = (0..SHARDS).map(|_| free_address()).collect();
        let workers: Vec<_> = hosts.iter().map(Host::worker).collect();
        let link = |(at, host): (usize, &Host)| {
            let address = &addresses[at];
            host.link(&format!(
                "name = \"base-{at}\"\nshards = \"shards.toml\"\n[network]\nlisten = [\"{address}\"]\n\
                 [worker]\n[[worker.take]]\nfrom = \"edge\"\n"
            ))
        };
        let links: Vec<_> = hosts.iter().enumerate().map(link).collect();
        let other = |name: &str, sides: &str| {
            format!(
                "name = \"{name}\"\nshards = \"shards.toml\"\n[network]\nconnect = {addresses:?}\n{sides}"
            )
        };
        let gives = edge.link(&other("edge", "[samples]\n"));
        let reads = desk.link(&other("desk", "[follow]\n"));
        let _source = edge.robots(&["--robots", &robots.to_string()]);
        let mut planner = desk.planner();
        for _ in 0..FIRST {
            planner.fresh_sample();
        }
        let all = || {
            let of = |children: &[joulebus_test_processes::Child]| {
                children.iter().map(|it| spent(it.pid())).sum::<u64>()
            };
            [
                of(&workers),
                of(&links),
                spent(gives.pid()),
                spent(reads.pid()),
            ]
        };
        let (begin, begin_ns) = (all(), clock::monotonic_ns());
        let mut age_ns = Vec::new();
        for _ in 0..FRAMES {
            let frame = planner.frame();
            let newest = frame.rows.iter().map(|row| row.stamp_ns).max();
            age_ns.push(frame.read_ns.saturating_sub(newest.unwrap_or_default()));
        }
        let took_s = (clock::monotonic_ns() - begin_ns) as f64 * 1e-9;
        let share = |at: usize| (all()[at] - begin[at]) as f64 / took_s;
        let (p50, p99) = spread(age_ns);
        println!(
            "figure: {SHARDS} shards, {robots} robots: {:.1} frames a second, newest sample to planner p50 {p50:.0} µs, p99 {p99:.0} µs; \
             % of a processor: workers {:.1}, their links {:.1}, robots' link {:.1}, planners' link {:.1}",
            FRAMES as f64 / took_s,
            share(0),
            share(1),
            share(2),
            share(3),
        );
    }
}
