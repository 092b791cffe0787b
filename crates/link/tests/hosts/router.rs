//! Links that are clients of a stock zenoh router.

use joulebus_test_processes::Child;
use zenoh::Wait as _;

use crate::host::{FOLLOW, Host, SAMPLES, free_address, of_other};

/// A router of zenoh's own, in this process.
fn router(address: &str) -> zenoh::Session {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"router\"".to_owned()),
        ("listen/endpoints", format!("[\"{address}\"]")),
        ("scouting/multicast/enabled", "false".to_owned()),
    ] {
        config.insert_json5(key, &value).unwrap();
    }
    zenoh::open(config).wait().unwrap()
}

fn client(name: &str, address: &str, sides: &str) -> String {
    of_other(name, address, sides).replacen("[network]", "[network]\nmode = \"client\"", 1)
}

#[test]
fn through_a_router_that_starts_late_and_again_robots_and_planners_elsewhere_work() {
    let (here, there) = (Host::new(), Host::new());
    let address = free_address();
    let _worker = here.worker();
    let take = "[worker]\n[[worker.take]]\nfrom = \"edge\"\n";
    let mut base = Child::spawn("link", here.link_command(&client("base", &address, take)));
    let sides = format!("{SAMPLES}{FOLLOW}");
    let edge = there.link_command(&client("edge", &address, &sides));
    let mut edge = Child::spawn("link", edge);
    base.wait_for_line("no router answers");
    edge.wait_for_line("no router answers");
    let first = router(&address);
    base.wait_for_line("is open");
    edge.wait_for_line("is open");
    let _robots = there.robots(&["--robots", "3"]);
    let mut planner = there.planner();
    planner.fresh_sample();
    first.close().wait().unwrap();
    drop(first);
    assert_eq!(planner.gone(), "Unreachable");
    let _second = router(&address);
    planner.fresh_sample();
}

#[test]
fn a_client_without_a_router_ends_when_it_is_asked_to() {
    let host = Host::new();
    let file = client("desk", &free_address(), FOLLOW);
    let mut link = Child::spawn("link", host.link_command(&file));
    link.wait_for_line("no router answers");
    assert_eq!(link.end().code(), Some(0));
    assert!(host.stale_files().is_empty());
}
