//! Hosts in network namespaces, joined by virtual cables that have delay and can be cut. Needs root
//! and `ip`: without them these tests log that they skip, and with `CI=true` they fail.

use std::io::{BufRead as _, BufReader};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use joulebus_testkit::Child;

use crate::host::{
    FOLLOW, Host, SAMPLES, disturbances, of_other, of_worker, silences, undisturbed,
};

/// Hosts with an address each, on one switch.
pub(crate) struct Wires {
    names: Vec<String>,
    switch: String,
}

fn ip(words: &str) -> bool {
    let words = words.split_whitespace();
    Command::new("ip").args(words).output().is_ok_and(|done| done.status.success())
}

impl Wires {
    /// Makes the hosts. `None` where namespaces cannot be made.
    pub(crate) fn new(hosts: usize) -> Option<Self> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let prefix = format!("jb{}n{}", std::process::id(), NUMBER.fetch_add(1, Ordering::Relaxed));
        let wires = Self {
            names: (0..hosts).map(|at| format!("{prefix}h{at}")).collect(),
            switch: format!("{prefix}sw"),
        };
        if wires.make() {
            return Some(wires);
        }
        let why = "network namespaces cannot be made here (root and `ip` are needed)";
        assert!(std::env::var_os("CI").is_none_or(|ci| ci != "true"), "{why}");
        eprintln!("skipped: {why}");
        None
    }

    fn make(&self) -> bool {
        let switch = &self.switch;
        let mut made = ip(&format!("netns add {switch}"))
            && ip(&format!("-n {switch} link add br0 type bridge"))
            && ip(&format!("-n {switch} link set br0 up"));
        for (at, name) in self.names.iter().enumerate() {
            made = made
                && ip(&format!("netns add {name}"))
                && ip(&format!("-n {name} link set lo up"))
                && ip(&format!(
                    "link add e0 netns {name} type veth peer name p{at} netns {switch}"
                ))
                && ip(&format!("-n {switch} link set p{at} master br0 up"))
                && ip(&format!("-n {name} addr add {}/24 dev e0", Self::address(at)))
                && ip(&format!("-n {name} link set e0 up"));
        }
        made
    }

    pub(crate) fn address(host: usize) -> String {
        format!("10.77.0.{}", host + 1)
    }

    pub(crate) fn host(&self, at: usize) -> Host {
        Host::within(Some(self.names[at].clone()))
    }

    /// A command that runs on a host.
    pub(crate) fn within(&self, at: usize, command: &Command) -> Command {
        let mut within = Command::new("ip");
        within.args(["netns", "exec", &self.names[at]]);
        within.arg(command.get_program()).args(command.get_args());
        within
    }

    /// Adds a second path between the first two hosts: 40 to 60 ms in each direction, with 1 % of
    /// the packets lost and the others reordered.
    fn long_way(&self) -> Way {
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/hosts/wan.py");
        let mut command = Command::new("python3");
        command.arg(script).args(&self.names[..2]);
        command.args(["40", "20", "1"]).stdout(Stdio::piped());
        let mut way = Way(command.spawn().unwrap());
        let mut line = String::new();
        let output = way.0.stdout.take().unwrap();
        BufReader::new(output).read_line(&mut line).unwrap();
        assert_eq!(line, "open\n");
        way
    }

    /// Cuts or restores the cable of a host. Packets are lost silently.
    pub(crate) fn set(&self, host: usize, is_whole: bool) {
        let state = if is_whole { "up" } else { "down" };
        assert!(ip(&format!("-n {} link set p{host} {state}", self.switch)));
    }
}

/// The process that forwards packets.
struct Way(std::process::Child);

impl Drop for Way {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Drop for Wires {
    fn drop(&mut self) {
        for name in self.names.iter().chain([&self.switch]) {
            ip(&format!("netns delete {name}"));
        }
    }
}

fn listening() -> String {
    format!("tcp/{}:7447", Wires::address(0))
}

#[test]
fn a_partition_is_reported_within_its_bound_and_after_it_all_goes_on_by_itself() {
    let Some(wires) = Wires::new(2) else { return };
    let (here, there) = (wires.host(0), wires.host(1));
    let mut worker = here.worker();
    let mut base = here.link(&of_worker(&listening(), &["edge"]));
    let mut edge = there.link(&of_other("edge", &listening(), &format!("{SAMPLES}{FOLLOW}")));
    let mut robots = there.robots(&["--format", "json", "--robots", "3"]);
    let mut planner = there.planner();
    planner.fresh_sample();
    wires.set(1, false);
    std::thread::sleep(Duration::from_millis(300));
    wires.set(1, true);
    planner.fresh_sample();
    let begin = Instant::now();
    wires.set(1, false);
    assert_eq!(planner.gone(), "Unreachable");
    assert!(begin.elapsed() > Duration::from_millis(500), "a second is no end");
    std::thread::sleep(Duration::from_secs(2));
    wires.set(1, true);
    planner.fresh_sample();
    planner.leave();
    let sent = robots.end().json()["samples_sent"].as_u64().unwrap();
    std::thread::sleep(Duration::from_millis(500));
    let edge = edge.end();
    assert!(edge.json()["taken"][0]["silences"].as_u64() >= Some(1), "{edge:?}");
    base.end();
    let report = worker.end().json();
    let dropped = report["samples_dropped"].as_object().unwrap().values();
    let dropped: u64 = dropped.filter_map(serde_json::Value::as_u64).sum();
    let known = report["samples_accepted"].as_u64().unwrap() + dropped;
    // Frames after the last one that arrived are not known to have been sent.
    assert!(known <= sent, "{known} of {sent}: {report}");
    assert!(dropped > 0, "the cut's samples are counted: {report}");
    assert_eq!((here.stale_files(), there.stale_files()), (vec![], vec![]));
}

/// Of a link with one receiving thread, as with TLS.
#[test]
fn a_host_that_is_cut_off_silences_no_other() {
    let Some(wires) = Wires::new(3) else { return };
    let [here, there, third] = [0, 1, 2].map(|at| wires.host(at));
    let _worker = here.worker();
    let mut command = here.link_command(&of_worker(&listening(), &["edge"]));
    command.env("ZENOH_RUNTIME", "(rx: (worker_threads: 1))");
    let mut base = Child::spawn("link", command);
    base.wait_for_line("is open");
    let _edge = there.link(&of_other("edge", &listening(), &format!("{SAMPLES}{FOLLOW}")));
    let _desk = third.link(&of_other("desk", &listening(), FOLLOW));
    let _robots = there.robots(&["--robots", "3"]);
    let mut beside = there.planner();
    beside.fresh_sample();
    let mut planner = third.planner();
    planner.fresh_sample();
    wires.set(1, false);
    let begin = Instant::now();
    let (mut last, mut longest) = (begin, Duration::ZERO);
    while begin.elapsed() < Duration::from_secs(9) {
        if planner.frame_within(Duration::from_millis(100)).is_some() {
            longest = longest.max(last.elapsed());
            last = Instant::now();
        }
    }
    longest = longest.max(last.elapsed());
    assert!(longest < Duration::from_secs(5), "no forecasts for {longest:?}");
}

#[test]
fn over_a_long_way_that_loses_and_reorders_packets_each_frame_comes_once_and_none_looks_fresher() {
    undisturbed(over_a_long_way);
}

/// Returns the disturbances of the worker's link.
fn over_a_long_way() -> u64 {
    let Some(wires) = Wires::new(2) else { return 0 };
    let _way = wires.long_way();
    let (here, there) = (wires.host(0), wires.host(1));
    let _worker = here.worker();
    let address = "tcp/10.78.0.1:7447";
    let base = here.link(&of_worker(address, &["edge"]));
    let sides = format!("{SAMPLES}{FOLLOW}");
    let mut edge = there.link(&of_other("edge", address, &sides));
    let _robots = there.robots(&["--robots", "3"]);
    let mut planner = there.planner();
    planner.fresh_sample();
    let mut last = (0, 0);
    for _ in 0..60 {
        let frame = planner.frame();
        assert!((frame.epoch, frame.tick) > last, "{last:?} {frame:?}");
        last = (frame.epoch, frame.tick);
        // All clocks are this machine's. A frame from the other host is at least one shortest path
        // delay old.
        let age_ns = frame.read_ns.checked_sub(frame.sent_ns);
        assert!(age_ns.is_some_and(|age_ns| age_ns >= 40_000_000), "{frame:?}");
    }
    planner.leave();
    let report = edge.end().json();
    let taken = &report["taken"][0];
    let silences = silences(taken);
    assert!(silences > 0 || taken["repeated"] == 0, "{report}");
    // At most half the round trip, plus the possible drift of the clocks.
    let uncertainty_s = taken["clock_uncertainty_s"].as_f64();
    let is_known = uncertainty_s.is_some_and(|uncertainty_s| (0.0..0.5).contains(&uncertainty_s));
    assert!(silences > 0 || is_known, "{report}");
    drop(base);
    disturbances(taken)
}
