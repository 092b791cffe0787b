//! A bridge to robots on `rmw_zenoh_cpp`, with Eclipse zenoh from PyPI as talker and listener.

use std::fs;
use std::path::PathBuf;

use joulebus_testkit::{Child, free_port, link_beside};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::json;

use super::{discharging, is_near, lines_of, status, twist};
use crate::fleet::Fleet;
use crate::ros2::peer::{Peer, cyclonedds};

const FILE: &str = r#"
    [robots]
    "r{id}" = "1-3"
    [ros2]
    domain_id = 7
    [[ros2.read]]
    topic = "/fleet/{robot}/battery_state"
    type = "sensor_msgs/msg/BatteryState"
    [[ros2.read]]
    topic = "/fleet/{robot}/odom"
    type = "nav_msgs/msg/Odometry"
    [[ros2.write]]
    what = "forecast"
    every_s = 0.1
    [[ros2.write]]
    what = "value"
    value = "reading_w"
    unit = "mW"
    every_s = 0.1
    [[ros2.write]]
    what = "diagnostics"
    every_s = 0.2
    "#;
/// Hashes of definitions, as ROS 2 Jazzy has them.
const FLOAT64: &str = "RIHS01_705ba9c3d1a09df43737eb67095534de36fd426c0587779bda2bc51fe790182a";
const BATTERY_STATE: &str =
    "RIHS01_4bee5dfce981c98faa6828b868307a0a73f992ed0789f374ee96c8f840e69741";
const DIAGNOSTIC_ARRAY: &str =
    "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e";
const ODOMETRY: &str = "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0";

fn bridge(fleet: &Fleet, address: &str) -> Child {
    link_beside(env!("CARGO_BIN_EXE_joulebus-bridge"));
    let mut command = fleet.command(FILE);
    let connect = format!("connect/endpoints=[\"{address}\"]");
    command.env("RMW_IMPLEMENTATION", "rmw_zenoh_cpp").env("ZENOH_CONFIG_OVERRIDE", connect);
    let mut bridge = Child::spawn("bridge", command);
    bridge.wait_for_line("over zenoh as node /joulebus_bridge: 6 topics read, 7 written");
    bridge
}

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
    let mut bridge = bridge(&fleet, &address);
    // By the whole key, as a subscriber of ROS 2 has it.
    for (topic, kind, hash) in [
        ("/r1/joulebus/reading_w", "Float64", FLOAT64),
        ("/r1/joulebus/forecast", "BatteryState", BATTERY_STATE),
        ("/diagnostics", "DiagnosticArray", DIAGNOSTIC_ARRAY),
    ] {
        peer.order(&json!({"hear": topic, "type": kind, "hash": hash}));
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
    let first = peer.wait_for(reading, 0, |it| is_near(&it["data"], 4_400.0));
    let later = peer.wait_for(reading, peer.received(), |it| it["data"].is_number());
    let (first, later) = (&first["attached"], &later["attached"]);
    assert!(later["number"].as_i64() > first["number"].as_i64(), "{first} {later}");
    assert_eq!((&first["gid"], &first["length"]), (&later["gid"], &json!(16)));
    assert!((-1.0..60.0).contains(&later["age_s"].as_f64().unwrap()), "{later}");
    let forecast = peer.wait_for("/r1/joulebus/forecast", 0, |it| it["current"].is_number());
    assert!(forecast["current"].as_f64().unwrap() < 0.0, "out of the battery: {forecast}");
    assert_ne!(forecast["attached"]["gid"], later["gid"], "each publisher has an id of its own");
    // Without velocities there would be no forecast, and an alarm.
    peer.wait_for("/diagnostics", 0, |it| status(it, "joulebus: r1")["level"] == 0);
    let node = "/NN/%/%/joulebus_bridge";
    let written = format!(
        "/joulebus_bridge/%r1%joulebus%forecast/sensor_msgs::msg::dds_::BatteryState_/{BATTERY_STATE}/::,10:,:,:,,"
    );
    let read = format!(
        "/joulebus_bridge/%fleet%r3%odom/nav_msgs::msg::dds_::Odometry_/{ODOMETRY}/2::,5:,:,:,,"
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
    let _worker = fleet.worker();
    let mut bridge = bridge(&fleet, &address);
    bridge.wait_for_line("no zenoh router and no other node is reached");
    let mut peer = Peer::within(&python, &address);
    let reading = "/r1/joulebus/reading_w";
    peer.order(&json!({"hear": reading, "type": "Float64", "hash": FLOAT64}));
    peer.publish("/fleet/r1/battery_state", "BatteryState", &discharging());
    peer.wait_for(reading, 0, |it| is_near(&it["data"], 4_400.0));
    let tasks = fs::read_dir(format!("/proc/{}/task", bridge.pid())).unwrap();
    let children = tasks.map(|task| fs::read_to_string(task.unwrap().path().join("children")));
    let children: String = children.map(Result::unwrap).collect();
    let child = children.trim().parse().ok().and_then(Pid::from_raw).unwrap();
    kill_process(child, Signal::KILL).unwrap();
    let ended = bridge.wait();
    assert_eq!(ended.code(), Some(1), "{ended:?}");
    assert!(ended.errors().contains("joulebus-link rmw-zenoh has ended: signal: 9"), "{ended:?}");
}
