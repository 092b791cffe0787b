//! Connections and starts that fail for lack of file descriptors, beside others that go on.

use std::time::Duration;

use joulebus_bus::inspect;
use joulebus_testkit::{Member, eventually};

use crate::harness::{Place, must};

/// Sends a frame, which the worker must receive. Returns whether it reported failed connections.
fn is_degraded(source: &mut Member, worker: &mut Member, number: u64) -> bool {
    let len = number % 60 + 1;
    assert_eq!(must(source, &format!("send {len}")), "1");
    let (wanted, mut is_degraded) = (format!("ok {number}:{len}"), false);
    eventually("the frame is received", || {
        let taken = worker.ask("take");
        is_degraded |= taken.contains("connections to writers failed");
        taken == wanted
    });
    is_degraded
}

#[test]
fn a_source_that_cannot_be_connected_and_dies_costs_the_others_no_frame() {
    let place = Place::new();
    let mut worker = place.joined("worker");
    let mut source = place.joined("source");
    assert!(!is_degraded(&mut source, &mut worker, 0));
    must(&mut worker, "files 0");
    let failing = place.joined("source");
    assert_eq!(must(&mut worker, "take"), "none");
    assert_eq!(must(&mut worker, "degraded"), "1");
    failing.kill();
    // The other source removes it, and nothing needs a retry. The worker does not look before: a
    // port still listed after three seconds, for lack of a processor, is an error.
    eventually("the dead one is removed", || {
        inspect(&place.domain).is_ok_and(|found| {
            found.nodes.len() == 2 && found.nodes.iter().all(|node| node.alive == Some(true))
        })
    });
    for number in 1..40 {
        assert!(!is_degraded(&mut source, &mut worker, number));
        std::thread::sleep(Duration::from_millis(100));
    }
    assert_eq!(must(&mut worker, "degraded"), "1");
}

#[test]
fn a_reader_connects_to_a_writer_once_it_has_file_descriptors_again() {
    let place = Place::new();
    let mut worker = place.joined("worker");
    let mut first = place.joined("source");
    assert!(!is_degraded(&mut first, &mut worker, 0));
    must(&mut worker, "files 0");
    let mut second = place.joined("source");
    must(&mut second, "send 1");
    let mut sent = 1;
    eventually("it is an error", || {
        sent += 1;
        is_degraded(&mut first, &mut worker, sent - 1)
            || worker.ask("take").contains("connections to writers failed")
    });
    must(&mut worker, "files 1000");
    eventually("its frames are received", || {
        must(&mut second, "send 64");
        worker.ask("take").contains(":64")
    });
}

#[test]
fn a_writer_connects_to_a_reader_once_it_has_file_descriptors_again() {
    let place = Place::new();
    let mut worker = place.joined("worker");
    let mut first = place.joined("planner");
    must(&mut worker, "tick 1");
    assert_eq!(must(&mut first, "latest"), "[Some(1), Some(1), Some(1)]");
    must(&mut worker, "files 0");
    let mut second = place.joined("planner");
    must(&mut worker, "tick 1");
    assert_eq!(must(&mut second, "latest"), "[None, None, None]");
    must(&mut worker, "files 1000");
    let mut ticks = 2;
    eventually("its frames reach the second planner", || {
        ticks += 1;
        must(&mut worker, "tick 1");
        let latest = must(&mut first, "latest");
        assert_eq!(latest, format!("[Some({ticks}), Some({ticks}), Some({ticks})]"));
        must(&mut second, "latest") == latest
    });
}

#[test]
fn a_start_with_few_file_descriptors_is_an_error_that_states_it_and_leaves_nothing() {
    const MAX: u64 = 200;
    let place = Place::new();
    let mut started = false;
    for more in (0..48).chain([MAX]) {
        for role in ["source", "worker", "planner"] {
            let mut member = place.member();
            must(&mut member, &format!("files {more}"));
            let mut answer = member.ask("join");
            if answer.starts_with("ok") {
                answer = member.ask(role);
            }
            assert!(
                answer.starts_with("ok")
                    || answer.contains("Too many open files")
                    || answer.contains("file descriptors"),
                "{role} with {more} descriptors: {answer}"
            );
            started |= answer.starts_with("ok");
            assert!(more < MAX || answer.starts_with("ok"), "{role}: {answer}");
            must(&mut member, "files 1000");
            member.finish();
        }
    }
    assert!(started);
}

#[test]
fn a_held_frame_keeps_its_bytes_when_its_reader_connects_anew() {
    let place = Place::new();
    let mut worker = place.joined("worker");
    let mut planner = place.joined("planner");
    must(&mut worker, "tick 1");
    assert_eq!(must(&mut planner, "hold"), "true");
    must(&mut planner, "files 0");
    // A second writer, to which it cannot connect.
    let mut impostor = place.joined("impostor");
    eventually("it is an error", || planner.ask("count").contains("connections to writers failed"));
    must(&mut planner, "files 1000");
    eventually("it is connected to it", || {
        must(&mut impostor, "tick 1");
        let _ = planner.ask("count");
        must(&mut planner, "foreign") != "0"
    });
    must(&mut worker, "tick 40");
    assert_eq!(must(&mut planner, "held"), "true");
}
