//! A bridge to robots on `rmw_zenoh_cpp`, with Eclipse zenoh from PyPI as talker and listener.

use std::fs;
use std::path::PathBuf;

use joulebus_testkit::{Child, free_port, link_beside};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::json;

use super::{
    BATTERY, DIAGNOSTICS, FORECAST, READING, discharging, file_with, is_near, lines_of, status,
    twist,
};
use crate::fleet::Fleet;
use crate::ros2::peer::{Peer, cyclonedds, hash};

/// A bridge's file with topics over zenoh.
pub(super) fn file() -> String {
    let odometry = ("odom", "nav_msgs/msg/Odometry");
    let writes = [FORECAST, READING, DIAGNOSTICS];
    file_with("domain_id = 7", &[BATTERY, odometry], &writes)
}

/// Starts a bridge over zenoh, and waits until it logs `expected`.
pub(super) fn bridge(fleet: &Fleet, address: &str, file: &str, expected: &str) -> Child {
    link_beside(env!("CARGO_BIN_EXE_joulebus-bridge"));
    let mut command = fleet.command(file);
    let connect = format!("connect/endpoints=[\"{address}\"]");
    command.env("RMW_IMPLEMENTATION", "rmw_zenoh_cpp").env("ZENOH_CONFIG_OVERRIDE", connect);
    let mut bridge = Child::spawn("bridge", command);
    bridge.wait_for_line(expected);
    bridge
}

const OPEN: &str = "over zenoh as node /joulebus_bridge: 6 topics read, 7 written";

/// Waits for a token of the graph that ends so, or until it is gone.
fn wait_for_token(peer: &Peer, end: &str, alive: bool) {
    peer.wait_for("@", 0, |change| {
        let token = change["token"].as_str().unwrap();
        change["alive"] == alive && token.ends_with(end)
    });
}

#[test]
fn robots_on_rmw_zenoh_are_forecast_and_the_bridge_is_a_node_of_their_graph() {
    let Some(python) = cyclonedds() else { return };
    let (fleet, address) = (Fleet::new(), format!("tcp/127.0.0.1:{}", free_port()));
    let mut worker = fleet.worker();
    let mut peer = Peer::within(&python, &address);
    let mut bridge = bridge(&fleet, &address, &file(), OPEN);
    // By the whole key, as a subscriber of ROS 2 has it.
    for (topic, kind) in [
        ("/r1/joulebus/reading_w", "Float64"),
        ("/r1/joulebus/forecast", "BatteryState"),
        ("/diagnostics", "DiagnosticArray"),
    ] {
        peer.subscribe(topic, kind);
    }
    peer.publish("/fleet/r1/battery_state", "BatteryState", &discharging());
    // ROS 2 Humble has no hashes.
    peer.order(&json!({
        "say": "/fleet/r1/odom", "type": "Odometry", "fields": {"twist": {"twist": twist()}},
        "hash": "TypeHashNotSupported",
    }));
    peer.publish("/fleet/r2/odom", "TwistStamped", &json!({}));
    peer.publish("/fleet/stranger/battery_state", "BatteryState", &discharging());
    peer.publish("/fleet/r3/battery_state", "Truncated", &json!({}));

    let reading = "/r1/joulebus/reading_w";
    let first = peer.wait_for(reading, 0, |reading| is_near(&reading["data"], 4.4));
    let later = peer.wait_for(reading, peer.received(), |reading| reading["data"].is_number());
    let (first, later) = (&first["attached"], &later["attached"]);
    assert!(later["number"].as_i64() > first["number"].as_i64(), "{first} {later}");
    assert_eq!((&first["gid"], &first["length"]), (&later["gid"], &json!(16)));
    assert!((-1.0..60.0).contains(&later["age_s"].as_f64().unwrap()), "{later}");
    let forecast =
        peer.wait_for("/r1/joulebus/forecast", 0, |forecast| forecast["current"].is_number());
    assert!(forecast["current"].as_f64().unwrap() < 0.0, "out of the battery: {forecast}");
    assert_ne!(forecast["attached"]["gid"], later["gid"], "each publisher has an id of its own");
    // Without velocities there would be no forecast, and an alarm.
    peer.wait_for("/diagnostics", 0, |array| status(array, "joulebus: r1")["level"] == 0);
    let node = "/NN/%/%/joulebus_bridge";
    let written = format!(
        "/joulebus_bridge/%r1%joulebus%forecast/sensor_msgs::msg::dds_::BatteryState_/{}/::,10:,:,:,,",
        hash("BatteryState")
    );
    let read = format!(
        "/joulebus_bridge/%fleet%r3%odom/nav_msgs::msg::dds_::Odometry_/{}/2::,5:,:,:,,",
        hash("Odometry")
    );
    for end in [node, &written, &read] {
        wait_for_token(&peer, end, true);
    }
    let report = bridge.end().json();
    wait_for_token(&peer, node, false);
    let names = |reason: &str| lines_of(&report, reason)[0]["names"].clone();
    assert_eq!(names("unknown_robot"), json!(["stranger"]), "{report}");
    let wrong = json!(["geometry_msgs::msg::dds_::TwistStamped_ of r2"]);
    assert_eq!(names("wrong_type"), wrong, "{report}");
    assert_eq!(names("not_cdr"), json!(["r3"]), "{report}");
    assert_eq!(report["not_written"], 0, "{report}");
    worker.stop();
    assert_eq!(fleet.stale_files(), Vec::<PathBuf>::new());
}

#[test]
fn robots_may_start_after_a_bridge_over_zenoh_which_ends_with_the_program_that_has_zenoh() {
    let Some(python) = cyclonedds() else { return };
    let (fleet, address) = (Fleet::new(), format!("tcp/127.0.0.1:{}", free_port()));
    let mut worker = fleet.worker();
    let mut bridge = bridge(&fleet, &address, &file(), OPEN);
    bridge.wait_for_line("no zenoh router and no other node is reached");
    let mut peer = Peer::within(&python, &address);
    let reading = "/r1/joulebus/reading_w";
    peer.subscribe(reading, "Float64");
    peer.publish("/fleet/r1/battery_state", "BatteryState", &discharging());
    peer.wait_for(reading, 0, |reading| is_near(&reading["data"], 4.4));
    let tasks = fs::read_dir(format!("/proc/{}/task", bridge.pid())).unwrap();
    let children = tasks.map(|task| fs::read_to_string(task.unwrap().path().join("children")));
    let children: String = children.map(Result::unwrap).collect();
    let child = children.trim().parse().ok().and_then(Pid::from_raw).unwrap();
    kill_process(child, Signal::KILL).unwrap();
    let ended = bridge.wait();
    assert_eq!(ended.code(), Some(1), "{ended:?}");
    assert!(ended.errors().contains("joulebus-link rmw-zenoh has ended: signal: 9"), "{ended:?}");
    worker.stop();
    assert_eq!(fleet.stale_files(), Vec::<PathBuf>::new());
}

/// Subscribers as rmw_zenoh has them for latched topics: zenoh-ext's, which ask for the history.
#[test]
fn late_subscribers_over_zenoh_get_the_newest_message_of_a_latched_topic_once() {
    let Some(python) = cyclonedds() else { return };
    let (fleet, address) = (Fleet::with_robots(101), format!("tcp/127.0.0.1:{}", free_port()));
    let mut worker = fleet.worker();
    let mut early = Peer::within(&python, &address);
    let latched = json!({
        "hear": "/diagnostics", "type": "DiagnosticArray", "transient_local": true, "depth": 1,
    });
    early.order(&latched);
    // Nothing is written again.
    let rarely = format!("{DIAGNOSTICS}\nevery_s = 3000");
    let file = file_with("domain_id = 7", &[BATTERY], &[&rarely, FORECAST]);
    let mut bridge = bridge(&fleet, &address, &file.replace("1-3", "1-100"), "101 written");
    let token = format!(
        "/%diagnostics/diagnostic_msgs::msg::dds_::DiagnosticArray_/{}/:1:,1:,:,:,,",
        hash("DiagnosticArray")
    );
    wait_for_token(&early, &token, true);
    early.wait_for("/diagnostics", 0, |note| note["attached"]["number"] == 1);
    let mut late = Peer::beside(&python, &address);
    late.order(&latched);
    let late_array = late.wait_for("/diagnostics", 0, |_| true);
    assert_eq!(late_array["attached"]["number"], 1, "{late_array}");
    assert_eq!(late_array["status"][0]["hardware_id"], "bridge", "{late_array}");
    assert_eq!(late_array["status"].as_array().map(Vec::len), Some(101), "{late_array}");
    // A later topic shows that nothing came twice.
    for peer in [&mut early, &mut late] {
        peer.publish("/fleet/r1/battery_state", "BatteryState", &discharging());
        peer.subscribe("/r1/joulebus/forecast", "BatteryState");
        peer.wait_for("/r1/joulebus/forecast", 0, |_| true);
        let mut arrays = 0;
        peer.each("/diagnostics", |_| arrays += 1);
        assert_eq!(arrays, 1);
    }
    bridge.stop();
    worker.stop();
    assert_eq!(fleet.stale_files(), Vec::<PathBuf>::new());
}
