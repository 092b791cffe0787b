//! Batteries that a person states: listed, in the log, recorded and recomputed.

use joulebus_testkit::eventually;
use rustix::process::Signal;

use crate::fleet::{Fleet, Program, code, json, output, stderr, stdout};

fn battery(fleet: &Fleet, arguments: &[&str]) -> (i32, String) {
    let ended = fleet.joulebus("battery").env("USER", "eve").args(arguments).output().unwrap();
    (code(&ended), stdout(&ended) + &stderr(&ended))
}

#[test]
fn a_battery_is_stated_by_a_person_and_its_tick_is_verified() {
    let fleet = Fleet::new();
    let (status, none) = battery(&fleet, &["1", "--full"]);
    assert!(status == 1 && none.contains("no worker serves fleet cli"), "{none}");
    let mut worker = fleet.worker();
    let capture = fleet.path("run.mcap");
    let mut recorder = Program::start({
        let mut record = fleet.joulebus("record");
        record.arg("-o").arg(&capture);
        record
    });
    recorder.wait_for_stderr("recording");
    let source = Program::start(fleet.joulebus("publish sim --robots 3"));
    eventually("three robots", || battery(&fleet, &[]).1.lines().count() == 3);
    for (arguments, wanted) in [
        (&["0", "--charge", ".3", "--by", "ann"][..], "robot 0: battery at 30 %, states ann\n"),
        (&["1", "--full"], "robot 1: battery full, states eve\n"),
        (&["2", "--exchanged"], "robot 2: battery exchanged, states eve\n"),
    ] {
        assert_eq!(battery(&fleet, arguments), (0, wanted.to_owned()));
        worker.wait_for_stderr(wanted.trim());
    }
    for (wrong, status, reason) in [
        (&["0", "--charge", "1.5"][..], 2, "allowed are 0 to 1"),
        (&["0", "--charge", ".5", "--full"], 2, "cannot be used with"),
        (&["--full"], 2, "required"),
        (&["0", "--full", "--by", ""], 2, "1 to 32 bytes"),
        (&["77777", "--full"], 1, "of no platform"),
        (&["77777"], 1, "robot 77777 is not in the fleet"),
    ] {
        let (found, printed) = battery(&fleet, wrong);
        assert!(found == status && printed.contains(reason), "{wrong:?}: {found} {printed}");
    }
    let listed = json(&fleet.output("battery --format json"));
    let soc = |robot: usize| listed["robots"][robot]["soc"].as_f64().unwrap();
    assert!((soc(0) - 0.3).abs() < 0.02 && soc(1) > 0.97, "{listed}");
    assert!(listed["robots"][0]["note"].is_null(), "{listed}");
    source.end(Signal::TERM);
    assert!(matches!(code(&recorder.end(Signal::TERM)), 0 | 3));
    assert_eq!(code(&worker.end(Signal::TERM)), 0);
    let verified = output(["replay", "--verify", "--format", "json", capture.to_str().unwrap()]);
    let report = json(&verified);
    assert_eq!(report["differences"], 0, "{report}");
    assert!(report["ticks_verified"].as_u64() > Some(30), "{report}");
}
