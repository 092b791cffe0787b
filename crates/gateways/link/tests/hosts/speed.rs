//! Measures what a link costs beside zenoh itself. It prints figures and asserts nothing about
//! them. In a release build:
//! `cargo test --release -p joulebus-link --test hosts -- --include-ignored --nocapture speed`.

use std::fs;
use std::path::PathBuf;
use std::time::Duration;

use joulebus_bus::clock;
use joulebus_consumer::{Event, Subscriber};
use joulebus_testkit::{Member, send_to_test};
use serde::{Deserialize, Serialize};
use zenoh::Wait as _;
use zenoh::qos::CongestionControl;

use crate::host::{FOLLOW, Host, free_address, of_other, of_worker};

const SEND: &str = "JOULEBUS_LINK_RAW_SEND";
const RECEIVE: &str = "JOULEBUS_LINK_RAW_RECEIVE";
const RELAY: &str = "JOULEBUS_LINK_RAW_RELAY";
const LISTEN: &str = "JOULEBUS_LINK_LISTEN";
const POLL: &str = "JOULEBUS_LINK_POLL";
const KEY: &str = "raw/frames";
const TICK: Duration = Duration::from_nanos(33_333_333);
/// The number of frames of a measurement, for a trial of it. 300 without it: ten seconds.
const FRAMES: &str = "JOULEBUS_LINK_FRAMES";
const FIRST: usize = 30;

/// A zenoh session with the transport settings of a link: a peer that is silent for a second is
/// gone, and there is room for a long frame. All other settings are zenoh's defaults.
fn session(key: &str, address: &str) -> zenoh::Session {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        (key, format!("[\"{address}\"]").as_str()),
        ("scouting/multicast/enabled", "false"),
        ("transport/link/tx/lease", "1000"),
        ("transport/link/tx/queue/size/data", "16"),
    ] {
        config.insert_json5(key, value).unwrap();
    }
    zenoh::open(config).wait().unwrap()
}

fn frames() -> usize {
    std::env::var(FRAMES).map_or(300, |frames| frames.parse().unwrap())
}

/// A frame as a process has read it.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct Seen {
    tick: u64,
    sent_ns: u64,
    read_ns: u64,
}

/// Reports to the test when the first frames have arrived, and at the end all later ones together.
/// Reports in between would cost the processor time that is measured.
fn collect(mut next: impl FnMut(&mut Vec<Seen>)) {
    send_to_test("joined");
    let mut seen = Vec::new();
    while seen.len() < FIRST {
        next(&mut seen);
    }
    send_to_test("begun");
    seen.clear();
    while seen.len() < frames() {
        next(&mut seen);
    }
    send_to_test(serde_json::to_string(&seen).unwrap());
    // The test reads this process's cost before it ends.
    std::thread::sleep(Duration::from_secs(3_600));
}

/// The processes that use zenoh alone, with an `address` and the size of a message or only the
/// address, and planners of a config.
pub(crate) fn run() {
    if let Ok(of) = std::env::var(SEND) {
        let (address, bytes) = of.split_once(' ').unwrap();
        send_raw(address, bytes.parse().unwrap());
    }
    if let Ok(address) = std::env::var(RECEIVE) {
        let session = session("connect/endpoints", &address);
        let subscriber = session.declare_subscriber(KEY).wait().unwrap();
        collect(|seen| {
            let sample = subscriber.recv().unwrap();
            let bytes = sample.payload().to_bytes();
            seen.push(Seen {
                tick: 0,
                sent_ns: u64::from_le_bytes(bytes[..8].try_into().unwrap()),
                read_ns: clock::monotonic_ns(),
            });
        });
    }
    if let Ok(of) = std::env::var(RELAY) {
        let (address, config) = of.split_once(' ').unwrap();
        relay_raw(address, config);
    }
    if let Some(config) = std::env::var_os(LISTEN) {
        let mut planner = Subscriber::connect(PathBuf::from(config)).unwrap();
        collect(|seen| {
            if let Event::Frame(frame) = planner.wait_next(Duration::from_secs(1)).unwrap() {
                seen.push(Seen {
                    tick: frame.header().tick,
                    sent_ns: frame.header().sent_ns,
                    read_ns: clock::monotonic_ns(),
                });
            }
        });
    }
    if let Some(config) = std::env::var_os(POLL) {
        let config = joulebus_config::Config::load(PathBuf::from(config)).unwrap();
        let mut planner = Subscriber::polling(&config, "near", Duration::from_millis(100)).unwrap();
        collect(|seen| {
            let each = |header: &joulebus_wire::ForecastHeader, _: &[_]| {
                seen.push(Seen { tick: header.tick, sent_ns: header.sent_ns, read_ns: 0 });
            };
            let _ = planner.wait_each(Duration::from_secs(1), each).unwrap();
        });
    }
}

fn send_raw(address: &str, bytes: usize) {
    let session = session("listen/endpoints", address);
    let publisher = session.declare_publisher(KEY).congestion_control(CongestionControl::Drop);
    let publisher = publisher.express(true).wait().unwrap();
    send_to_test("joined");
    loop {
        let mut message = vec![0; bytes];
        message[..8].copy_from_slice(&clock::monotonic_ns().to_le_bytes());
        publisher.put(message).wait().unwrap();
        std::thread::sleep(TICK);
    }
}

/// Copies each frame of forecasts as it is into a message of zenoh.
fn relay_raw(address: &str, config: &str) {
    let session = session("listen/endpoints", address);
    let publisher = session.declare_publisher(KEY).congestion_control(CongestionControl::Drop);
    let publisher = publisher.express(true).wait().unwrap();
    let mut planner = Subscriber::connect(PathBuf::from(config)).unwrap();
    send_to_test("joined");
    loop {
        if let Event::Frame(frame) = planner.wait_next(Duration::from_secs(1)).unwrap() {
            let mut message = frame.header().sent_ns.to_le_bytes().to_vec();
            message.extend_from_slice(bytemuck::cast_slice(frame.robots()));
            publisher.put(message).wait().unwrap();
        }
    }
}

/// Processor time that the processes have used, in ticks of the kernel's clock (100 a second).
fn spent(pids: &[u32]) -> u64 {
    let of = |pid: &u32| {
        let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
        let fields: Vec<&str> = stat.rsplit(") ").next().unwrap().split(' ').collect();
        fields[11].parse::<u64>().unwrap() + fields[12].parse::<u64>().unwrap()
    };
    pids.iter().map(of).sum()
}

/// Median and 99th percentile, µs.
fn spread(mut all_ns: Vec<u64>) -> (f64, f64) {
    all_ns.sort_unstable();
    let at = |share: usize| all_ns[all_ns.len() * share / 100] as f64 / 1_000.0;
    (at(50), at(99))
}

/// One-way times, µs, and the processor share of the processes that carried the frames.
#[derive(Debug, Clone, Copy)]
struct Cost {
    p50: f64,
    p99: f64,
    cpu: f64,
}

fn cost((p50, p99): (f64, f64), ticks: u64) -> Cost {
    let cpu = ticks as f64 / (frames() as f64 / 30.0);
    Cost { p50, p99, cpu }
}

/// A process of the test binary.
fn process(key: &str, value: impl AsRef<std::ffi::OsStr>) -> Member {
    let mut command = Member::command();
    command.env(key, value);
    let mut member = Member::spawn(key, command);
    assert_eq!(member.next_line(), "joined");
    member
}

/// The frames of a process, and the processor time of `pids` in between.
fn collected(from: &mut Member, pids: &[u32]) -> (Vec<Seen>, u64) {
    assert_eq!(from.next_line(), "begun");
    let begin = spent(pids);
    let seen = from.next_line();
    (serde_json::from_str(&seen).unwrap(), spent(pids) - begin)
}

fn took_ns(seen: &[Seen]) -> Vec<u64> {
    let took = seen.iter().map(|frame| frame.read_ns - frame.sent_ns);
    took.collect()
}

fn raw(bytes: usize) -> Cost {
    let address = free_address();
    let sender = process(SEND, format!("{address} {bytes}"));
    let mut receiver = process(RECEIVE, address);
    let pids = [sender.pid(), receiver.pid()];
    let (seen, ticks) = collected(&mut receiver, &pids);
    cost(spread(took_ns(&seen)), ticks)
}

/// Measures zenoh alone after a hop: what a link at least does, beside the same worker. It checks,
/// converts and acknowledges nothing, and ends before the second hop.
fn relayed(here: &Host) -> Cost {
    let address = free_address();
    let relay = process(RELAY, format!("{address} {}", here.config().display()));
    let mut receiver = process(RECEIVE, address);
    let pids = [relay.pid(), receiver.pid()];
    let (seen, ticks) = collected(&mut receiver, &pids);
    cost(spread(took_ns(&seen)), ticks)
}

/// Measures the path from the worker to a planner beside it, without computation.
fn hop(here: &Host) -> Cost {
    let mut near = process(LISTEN, here.config());
    let pids = [near.pid()];
    let (seen, ticks) = collected(&mut near, &pids);
    cost(spread(took_ns(&seen)), ticks)
}

/// Measures forecasts over a link, from the worker's sending to the reading elsewhere, with the
/// number of dropped frames.
fn linked(here: &Host, robots: usize) -> (Cost, u64) {
    let there = Host::of(robots);
    let address = free_address();
    let base = here.link(&of_worker(&address, &[]));
    let follows = format!("{FOLLOW}services = []\n");
    let mut desk = there.link(&of_other("desk", &address, &follows));
    // This planner polls now and then, so that it wakes no processor at a tick.
    let mut near = process(POLL, here.config());
    let mut far = process(LISTEN, there.config());
    let (read, ticks) = collected(&mut far, &[base.pid(), desk.pid()]);
    let (sent, _) = collected(&mut near, &[]);
    let took = read.iter().filter_map(|there| {
        let here = sent.iter().find(|here| here.tick == there.tick)?;
        Some(there.read_ns - here.sent_ns)
    });
    let took_ns: Vec<u64> = took.collect();
    assert!(took_ns.len() > frames() / 2, "{}", took_ns.len());
    let dropped = desk.end().json()["taken"][0]["dropped"].as_u64().unwrap();
    (cost(spread(took_ns), ticks), dropped)
}

/// Number of rounds. Their medians are shown.
const ROUNDS: usize = 3;

fn median(rounds: &[Cost]) -> Cost {
    let of = |part: fn(&Cost) -> f64| {
        let mut all: Vec<f64> = rounds.iter().map(part).collect();
        all.sort_unstable_by(f64::total_cmp);
        all[all.len() / 2]
    };
    Cost { p50: of(|cost| cost.p50), p99: of(|cost| cost.p99), cpu: of(|cost| cost.cpu) }
}

fn show(what: &str, robots: usize, cost: Cost) {
    let Cost { p50, p99, cpu } = cost;
    println!(
        "figure: {what}, {robots} robots: p50 {p50:.0} µs, p99 {p99:.0} µs, {cpu:.1} % of a processor"
    );
}

/// Measures zenoh alone, the path to a planner beside the worker, and a link, in turn and with the
/// same worker and robots.
#[test]
#[ignore = "prints figures: docs/measured/performance.md"]
fn speed_of_forecasts_over_a_link_beside_zenoh_alone() {
    for robots in [100, 1_000, 10_000] {
        let [mut raws, mut hops, mut relays, mut links] = [const { Vec::new() }; 4];
        let here = Host::of(robots);
        let _worker = here.worker();
        let _robots = here.robots(&["--robots", &robots.to_string()]);
        // The size of a link's message.
        let bytes = 112 + 320 + 72 * robots;
        for round in 1..=ROUNDS {
            raws.push(raw(bytes));
            hops.push(hop(&here));
            relays.push(relayed(&here));
            let (cost, dropped) = linked(&here, robots);
            links.push(cost);
            let all = [("zenoh", &raws), ("hop", &hops), ("relay", &relays), ("link", &links)];
            for (what, all) in all {
                show(&format!("{what}, round {round}"), robots, all[round - 1]);
            }
            println!("figure: round {round}, {robots} robots: {dropped} frames left out");
        }
        let [raw, hop, relay, link] = [&raws, &hops, &relays, &links].map(|all| median(all));
        for (what, cost) in [("zenoh", raw), ("hop", hop), ("relay", relay), ("link", link)] {
            show(&format!("{what}, median, {bytes} bytes"), robots, cost);
        }
        println!(
            "figure: {robots} robots, link over zenoh: p50 {:.2}, p99 {:.2}, processor {:.2}; over zenoh and two hops: \
             p50 {:.2}, p99 {:.2}, processor {:.2}; over relay and hop: p50 {:.2}, p99 {:.2}, processor {:.2}",
            link.p50 / raw.p50,
            link.p99 / raw.p99,
            link.cpu / raw.cpu,
            link.p50 / (raw.p50 + 2.0 * hop.p50),
            link.p99 / (raw.p99 + 2.0 * hop.p99),
            link.cpu / (raw.cpu + 2.0 * hop.cpu),
            link.p50 / (relay.p50 + hop.p50),
            link.p99 / (relay.p99 + hop.p99),
            link.cpu / (relay.cpu + hop.cpu),
        );
    }
}
