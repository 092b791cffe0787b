//! Hosts in network namespaces, joined by virtual cables that are cut and have delay. Needs root and `ip`: without them these
//! tests say so and pass, and with `CI=true` they fail.

use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use crate::host::{FOLLOW, Host, SAMPLES, of_other, of_worker};

/// Some hosts with an address each, on one switch.
struct Wires {
    names: Vec<String>,
    switch: String,
}

fn ip(words: &str) -> bool {
    let words = words.split_whitespace();
    Command::new("ip")
        .args(words)
        .output()
        .is_ok_and(|done| done.status.success())
}

impl Wires {
    /// `None` where namespaces cannot be made.
    fn new(hosts: usize) -> Option<Self> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let prefix = format!(
            "jb{}n{}",
            std::process::id(),
            NUMBER.fetch_add(1, Ordering::Relaxed)
        );
        let wires = Self {
            names: (0..hosts).map(|at| format!("{prefix}h{at}")).collect(),
            switch: format!("{prefix}sw"),
        };
        if wires.make() {
            return Some(wires);
        }
        let why = "network namespaces cannot be made here (root and `ip` are needed)";
        assert!(
            std::env::var_os("CI").is_none_or(|ci| ci != "true"),
            "{why}"
        );
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
                && ip(&format!(
                    "-n {name} addr add {}/24 dev e0",
                    Self::address(at)
                ))
                && ip(&format!("-n {name} link set e0 up"));
        }
        made
    }

    fn address(host: usize) -> String {
        format!("10.77.0.{}", host + 1)
    }

    fn host(&self, at: usize) -> Host {
        Host::within(Some(self.names[at].clone()))
    }

    /// Cuts or mends the cable of a host; packets are lost in silence.
    fn set(&self, host: usize, is_whole: bool) {
        let state = if is_whole { "up" } else { "down" };
        assert!(ip(&format!("-n {} link set p{host} {state}", self.switch)));
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
fn a_partition_is_told_within_its_bound_and_after_it_all_goes_on_by_itself() {
    let Some(wires) = Wires::new(2) else { return };
    let (here, there) = (wires.host(0), wires.host(1));
    let mut worker = here.worker();
    let mut base = here.link(&of_worker(&listening(), &["edge"]));
    let mut edge = there.link(&of_other(
        "edge",
        &listening(),
        &format!("{SAMPLES}{FOLLOW}"),
    ));
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
    assert!(
        begin.elapsed() > Duration::from_millis(500),
        "a second is no end"
    );
    std::thread::sleep(Duration::from_secs(2));
    wires.set(1, true);
    planner.fresh_sample();
    planner.leave();
    let sent = robots.end().json()["samples_sent"].as_u64().unwrap();
    std::thread::sleep(Duration::from_millis(500));
    let edge = edge.end();
    assert!(
        edge.json()["taken"][0]["silences"].as_u64() >= Some(1),
        "{edge:?}"
    );
    base.end();
    let report = worker.end().json();
    let dropped = report["samples_dropped"].as_object().unwrap().values();
    let dropped: u64 = dropped.filter_map(serde_json::Value::as_u64).sum();
    let known = report["samples_accepted"].as_u64().unwrap() + dropped;
    // Those after the last frame that came are not known to have been sent.
    assert!(known <= sent, "{known} of {sent}: {report}");
    assert!(dropped > 0, "the cut's samples are counted: {report}");
    assert_eq!((here.stale_files(), there.stale_files()), (vec![], vec![]));
}
