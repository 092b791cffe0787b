//! Every sample that robots have sent is accepted or dropped, over takeovers. That it is so over
//! restarts of links is tested in each seed of linked hosts (`simulator`).

use std::time::Duration;

use joulebus_testkit::Child;
use rustix::process::Signal;

use crate::host::Host;
use crate::standby::{Scene, fresh};

/// Ends the robots, and asserts that the worker of `host` knows of each of their samples.
fn assert_all_are_known(robots: &mut Child, host: &Host) {
    let sent = robots.end().json()["samples_sent"].as_u64();
    let mut known = None;
    let begin = std::time::Instant::now();
    while begin.elapsed() < Duration::from_secs(20) && known != sent {
        known = host.known_samples();
    }
    assert_eq!(known, sent, "accepted or dropped, of those that were sent: {:?}", host.watched());
}

#[test]
fn every_sample_is_accepted_or_dropped_over_takeovers() {
    let Some((scene, _etcd)) = Scene::with_lease() else {
        return;
    };
    let mut workers = [0, 1].map(|at| scene.worker(at));
    let mut links = scene.base_links(&mut workers);
    let _field = scene.field_link();
    let mut robots = scene.robots();
    let mut planner = scene.field.planner();
    fresh(&mut planner);
    let mut at = 0;
    for is_killed in [true, false, true] {
        scene.state_crosses_to(1 - at);
        match is_killed {
            true => {
                links[at].kill();
                workers[at].kill();
            }
            false => workers[at].signal(Signal::STOP),
        }
        workers[1 - at].wait_for_line("ready:");
        fresh(&mut planner);
        if is_killed {
            links[at] = scene.base_link(at);
        } else {
            workers[at].signal(Signal::CONT);
            workers[at].wait();
        }
        workers[at] = scene.worker(at);
        at = 1 - at;
    }
    // The leader's link alone starts again.
    links[at].kill();
    links[at] = scene.base_link(at);
    fresh(&mut planner);
    planner.leave();
    assert_all_are_known(&mut robots, &scene.bases[at]);
}
