//! Random cuts, kills and pauses of everything between robots and planners. The promises are
//! checked after each fault and at the end.

use std::time::Duration;

use joulebus_testkit::{Child, eventually};
use rustix::process::Signal;
use serde_json::Value;

use crate::host::{FOLLOW, Host, SAMPLES, of_other, of_worker};
use crate::namespaces::{Wires, listening};
use crate::planner::Reader;

/// Number of faults in the gate. The variable allows more.
pub(crate) const FAULTS: usize = 6;
pub(crate) const MORE: &str = "JOULEBUS_LINK_FAULTS";

/// A pseudo-random sequence that is the same in every run.
pub(crate) struct Chance(pub(crate) u64);

impl Chance {
    pub(crate) fn below(&mut self, most: u64) -> u64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % most
    }

    pub(crate) fn while_s(&mut self, most_ms: u64) -> Duration {
        Duration::from_millis(50 + self.below(most_ms))
    }
}

/// Robots on one host, their worker on another, and a planner beside the robots.
struct Fleet {
    wires: Wires,
    here: Host,
    there: Host,
    base: Child,
    edge: Child,
}

impl Fleet {
    fn base_file() -> String {
        of_worker(&listening(), &["edge"])
    }

    fn edge_file() -> String {
        of_other("edge", &listening(), &format!("{SAMPLES}{FOLLOW}"))
    }

    /// Injects one fault, and removes it.
    fn fault(&mut self, chance: &mut Chance) -> &'static str {
        match chance.below(6) {
            0 => self.cut(chance.while_s(900), "a short cut"),
            1 => self.cut(chance.while_s(3_000), "a cut"),
            2 => {
                self.base.kill();
                self.base = self.here.link(&Self::base_file());
                "the worker's link killed"
            }
            3 => {
                self.edge.kill();
                std::thread::sleep(chance.while_s(500));
                self.edge = self.there.link(&Self::edge_file());
                "the robots' link killed"
            }
            4 => Self::pause(&mut self.base, chance.while_s(2_500), "the worker's link stopped"),
            _ => Self::pause(&mut self.edge, chance.while_s(2_500), "the robots' link stopped"),
        }
    }

    fn cut(&self, time: Duration, what: &'static str) -> &'static str {
        self.wires.set(1, false);
        std::thread::sleep(time);
        self.wires.set(1, true);
        what
    }

    fn pause(link: &mut Child, time: Duration, what: &'static str) -> &'static str {
        link.signal(Signal::STOP);
        std::thread::sleep(time);
        link.signal(Signal::CONT);
        what
    }
}

/// Reads until a frame has a sample that was taken after this call. No frame may come twice,
/// backwards or from the future.
fn goes_on(planner: &mut Reader, last: &mut (u64, u64), after: &str) {
    let now_ns = joulebus_bus::clock::monotonic_ns();
    loop {
        let frame = planner.frame();
        let place = (frame.epoch, frame.tick);
        assert!(place > *last, "after {after}: {last:?}, then {place:?}");
        assert!(frame.sent_ns <= frame.read_ns, "after {after}");
        *last = place;
        if frame.rows.iter().any(|row| row.stamp_ns > now_ns) {
            return;
        }
    }
}

/// A host's ledger of each robot: robot, energy, metered and unmetered time. Empty while the host
/// has no worker.
fn ledgers(host: &Host) -> Vec<[Value; 4]> {
    let Some(report) = host.watched() else {
        return Vec::new();
    };
    let robots = report["robots"].as_array().unwrap();
    let row = |robot: &Value| {
        ["robot", "drawn_j", "metered_s", "unmetered_s"].map(|key| robot[key].clone())
    };
    robots.iter().map(row).collect()
}

#[test]
fn through_cuts_kills_and_stops_frames_stay_in_order_and_ledgers_and_samples_are_accounted_for() {
    let Some(wires) = Wires::new(2) else { return };
    let (here, there) = (wires.host(0), wires.host(1));
    let mut worker = here.worker();
    let base = here.link(&Fleet::base_file());
    let edge = there.link(&Fleet::edge_file());
    let mut fleet = Fleet { wires, here, there, base, edge };
    let mut robots = fleet.there.robots(&["--format", "json", "--robots", "3"]);
    let (mut chance, mut last) = (Chance(7), (0, 0));
    let faults = std::env::var(MORE).map_or(FAULTS, |count| count.parse().unwrap());
    let mut planner = fleet.there.planner();
    goes_on(&mut planner, &mut last, "the start");
    for at in 0..faults {
        let fault = fleet.fault(&mut chance);
        // Programs beside a killed link took it for the end of the worker. They find the next one.
        goes_on(&mut planner, &mut last, fault);
        if faults > FAULTS {
            println!("figure: {} of {faults}: {fault}", at + 1);
        }
    }
    planner.leave();
    let sent = robots.end().json()["samples_sent"].as_u64().unwrap();
    // Every sample sent has arrived or is counted as lost.
    let mut own = Vec::new();
    eventually("both hosts report the same", || {
        own = ledgers(&fleet.here);
        own.len() == 3 && own == ledgers(&fleet.there)
    });
    for [robot, _, metered_s, unmetered_s] in &own {
        let both = [metered_s, unmetered_s].map(|time| time.as_f64().unwrap());
        assert!(both.iter().all(|time| *time > 0.0), "{robot}: {both:?}");
    }
    fleet.edge.end();
    fleet.base.end();
    let report = worker.end().json();
    let dropped = report["samples_dropped"].as_object().unwrap().values();
    let dropped: u64 = dropped.filter_map(Value::as_u64).sum();
    let known = report["samples_accepted"].as_u64().unwrap() + dropped;
    assert!(known <= sent, "{known} of {sent}: {report}");
    assert_eq!((fleet.here.stale_files(), fleet.there.stale_files()), (vec![], vec![]));
}
