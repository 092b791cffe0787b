//! Links that connect as clients to a stock zenoh router.

use joulebus_testkit::{Child, Member, send_to_test};
use zenoh::Wait as _;

use crate::host::{FOLLOW, Host, SAMPLES, free_address, of_other};
use crate::namespaces::Wires;

const ROUTER: &str = "JOULEBUS_LINK_ROUTER";

/// Starts a zenoh router in this process.
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

/// A router's process, which runs until it is killed. The variable has its address.
pub(crate) fn run() {
    if let Ok(address) = std::env::var(ROUTER) {
        let _session = router(&address);
        send_to_test("open");
        loop {
            std::thread::park();
        }
    }
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

#[test]
fn three_hosts_with_a_router_on_a_fourth_go_on_after_it_was_killed_and_cut_off() {
    let Some(wires) = Wires::new(4) else { return };
    let address = format!("tcp/{}:7447", Wires::address(3));
    let route = || {
        let mut command = wires.within(3, &Member::command());
        command.env(ROUTER, &address);
        let mut router = Member::spawn("router", command);
        assert_eq!(router.next_line(), "open");
        router
    };
    let first = route();
    let (here, robots, desk) = (wires.host(0), wires.host(1), wires.host(2));
    let _worker = here.worker();
    let take = "[worker]\n[[worker.take]]\nfrom = \"edge\"\n";
    let _base = here.link(&client("base", &address, take));
    let _edge = robots.link(&client("edge", &address, SAMPLES));
    let _desk = desk.link(&client("desk", &address, FOLLOW));
    let _robots = robots.robots(&["--robots", "3"]);
    let mut planner = desk.planner();
    planner.fresh_sample();
    first.kill();
    assert_eq!(planner.gone(), "Unreachable");
    let _second = route();
    planner.fresh_sample();
    wires.set(3, false);
    assert_eq!(planner.gone(), "Unreachable");
    wires.set(3, true);
    planner.fresh_sample();
}
