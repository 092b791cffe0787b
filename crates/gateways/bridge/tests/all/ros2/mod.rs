//! A bridge to ROS 2 beside a real worker, with another vendor's DDS as publisher and subscriber.
//! Without it the tests log that they skip, and with CI=true they fail.

mod garbage;
pub(crate) mod peer;
mod rmw;
mod services;
mod simulated;

use std::net::UdpSocket;
use std::path::PathBuf;

use crate::fleet::{Fleet, unmapped};
use joulebus_testkit::Child;
use peer::{Peer, RosDomain, cyclonedds, ros2};
use rustix::process::Signal;
use serde_json::{Value, json};

/// A bridge's file for robots 1 to 3: keys of `[ros2]`, topics `/fleet/{robot}/NAME` to read with
/// their types, and what to write.
fn file_with(keys: &str, reads: &[(&str, &str)], writes: &[&str]) -> String {
    let mut text = format!("[robots]\n\"r{{id}}\" = \"1-3\"\n[ros2]\n{keys}\n");
    for (name, kind) in reads {
        text += &format!("[[ros2.read]]\ntopic = \"/fleet/{{robot}}/{name}\"\ntype = \"{kind}\"\n");
    }
    for write in writes {
        text += &format!("[[ros2.write]]\n{write}\n");
        if !write.contains("every_s") {
            text += "every_s = 0.1\n";
        }
    }
    text
}

const BATTERY: (&str, &str) = ("battery_state", "sensor_msgs/msg/BatteryState");
const COMMANDS: (&str, &str) = ("cmd_vel", "geometry_msgs/msg/Twist");
const READING: &str = "what = \"value\"\nvalue = \"reading_w\"";
const POWER_W: &str = "what = \"value\"\nvalue = \"power_w\"";
const FORECAST: &str = "what = \"forecast\"";
const BUDGET: &str = "what = \"budget\"";
const DIAGNOSTICS: &str = "what = \"diagnostics\"";

/// The keys of a bridge in this domain.
fn keys(domain: &RosDomain) -> String {
    format!("domain_id = {}\nnetworks = [\"127.0.0.1\"]", domain.id)
}

/// A bridge's file with all kinds of topics.
fn file(domain: &RosDomain) -> String {
    let writes = [FORECAST, BUDGET, READING, POWER_W, DIAGNOSTICS];
    file_with(&keys(domain), &[BATTERY, COMMANDS], &writes)
}

/// A battery of 4 V that is discharged with 4.4 W.
fn discharging() -> Value {
    json!({
        "voltage": 4.0, "current": -1.1, "percentage": 0.8, "power_supply_status": 2, "present": true,
    })
}

fn twist() -> Value {
    json!({"linear": {"x": 0.1}, "angular": {"z": 0.2}})
}

fn is_near(value: &Value, expected: f64) -> bool {
    value.as_f64().is_some_and(|value| (value - expected).abs() < 1e-3 * expected.abs())
}

/// The status of a robot in an array of diagnostics.
fn status<'d>(diagnostics: &'d Value, name: &str) -> &'d Value {
    let all = diagnostics["status"].as_array().unwrap();
    let found = all.iter().find(|status| status["name"] == name);
    found.unwrap_or(&Value::Null)
}

/// The value of a key of a status.
fn text<'d>(status: &'d Value, key: &str) -> &'d str {
    let values = status["values"].as_array().map_or(&[][..], Vec::as_slice);
    let found = values.iter().find(|value| value["key"] == key);
    found.and_then(|value| value["value"].as_str()).unwrap_or("")
}

fn lines_of<'r>(report: &'r Value, reason: &str) -> Vec<&'r Value> {
    let all = report["unmapped"].as_array().unwrap();
    all.iter().filter(|line| line["reason"] == reason).collect()
}

#[test]
fn battery_states_and_twists_are_forecast_and_forecasts_budgets_and_diagnostics_are_received() {
    let Some(python) = cyclonedds() else { return };
    let (fleet, domain) = (Fleet::new(), RosDomain::take());
    let mut worker = fleet.worker();
    let mut bridge = fleet.bridge(&file(&domain), "in ROS domain");
    let mut peer = Peer::start(&python, &domain);
    for (topic, kind) in [
        ("/r1/joulebus/forecast", "BatteryState"),
        ("/r1/joulebus/reading_w", "Float64"),
        ("/r1/joulebus/power_w", "Float64"),
        ("/diagnostics", "DiagnosticArray"),
    ] {
        peer.subscribe(topic, kind);
    }
    // As a latched topic.
    peer.order(
        &json!({"hear": "/r1/joulebus/budget", "type": "BatteryState", "transient_local": true}),
    );
    // It has come after the bridge, whose node it discovers.
    let graph = json!({"hear": "ros_discovery_info", "type": "ParticipantEntitiesInfo", "transient_local": true});
    peer.order(&graph);
    let node = peer
        .wait_for("ros_discovery_info", 0, |graph| graph["node_entities_info_seq"][0].is_object());
    let node = &node["node_entities_info_seq"][0];
    assert_eq!(
        (&node["node_namespace"], &node["node_name"]),
        (&json!("/"), &json!("joulebus_bridge"))
    );
    let endpoints = |of: &str| node[of].as_array().map(Vec::len);
    assert_eq!((endpoints("reader_gid_seq"), endpoints("writer_gid_seq")), (Some(6), Some(13)));
    peer.publish("/fleet/r1/battery_state", "BatteryState", &discharging());
    peer.publish("/fleet/r1/cmd_vel", "Twist", &twist());
    peer.publish("/fleet/stranger/battery_state", "BatteryState", &discharging());

    peer.wait_for("/r1/joulebus/reading_w", 0, |document| is_near(&document["data"], 4.4));
    let power = peer.wait_for("/r1/joulebus/power_w", 0, |document| document["data"].is_number());
    let power_w = power["data"].as_f64().unwrap();
    assert!((0.0..20.0).contains(&power_w), "{power}");
    let forecast =
        peer.wait_for("/r1/joulebus/forecast", 0, |document| document["current"].is_number());
    assert!(forecast["current"].as_f64().unwrap() < 0.0, "out of the battery: {forecast}");
    assert!(is_near(&forecast["voltage"], 4.0), "{forecast}");
    assert_eq!(
        (&forecast["percentage"], &forecast["temperature"]),
        (&Value::Null, &Value::Null),
        "NaN is not known: {forecast}"
    );
    assert_eq!(forecast["header"]["frame_id"], "r1");
    assert_eq!(forecast["power_supply_status"], 2);
    let stamp_s = forecast["header"]["stamp"]["sec"].as_i64().unwrap();
    assert!(stamp_s > 1_600_000_000, "the wall clock's time: {forecast}");
    let budget = peer.wait_for("/r1/joulebus/budget", 0, |document| {
        document["percentage"].as_f64().is_some_and(|share| share < 0.99)
            && document["charge"].is_number()
    });
    assert_eq!(budget["current"], Value::Null, "{budget}");
    // A worker is live while its newest frame is younger than two periods.
    let document = peer.wait_for("/diagnostics", 0, |document| {
        let robot = status(document, "joulebus: r1");
        let of_worker = status(document, "joulebus: worker of lab");
        let is_live = of_worker["level"] == 0 && of_worker["message"] == "worker live";
        is_live && text(robot, "power_w").parse::<f64>().is_ok()
    });
    let robot = status(&document, "joulebus: r1");
    assert_eq!(robot["hardware_id"], "r1");
    assert!(text(robot, "usable_j").parse::<f64>().is_ok(), "{robot}");
    assert!(text(robot, "quality_detail") != "NoCommand", "{robot}");
    let silent = status(&document, "joulebus: r3");
    assert_eq!(silent["level"], 3, "nothing has come of it: {silent}");

    let report = bridge.end().json();
    let unknown = lines_of(&report, "unknown_robot");
    assert_eq!(
        (&unknown[0]["route"], &unknown[0]["names"], &unknown[0]["count"]),
        (&json!("/fleet/{robot}/battery_state"), &json!(["stranger"]), &json!(1)),
        "{report}"
    );
    assert_eq!(report["not_written"], 0, "{report}");
    assert!(report["published"]["samples"].as_u64().unwrap() > 0, "{report}");
    worker.stop();
    assert_eq!(fleet.stale_files(), Vec::<PathBuf>::new());
}

#[test]
fn odometry_and_stamped_twists_are_read_from_publishers_of_either_reliability() {
    let Some(python) = cyclonedds() else { return };
    let (fleet, domain) = (Fleet::new(), RosDomain::take());
    let mut worker = fleet.worker();
    let battery =
        format!("{}\"\ncurrent = \"discharge_positive\"\npercentage_unit = \"%", BATTERY.1);
    let reads = [
        ("odom", "nav_msgs/msg/Odometry"),
        ("cmd_vel", "geometry_msgs/msg/TwistStamped"),
        ("battery", &battery),
    ];
    let file = file_with(&keys(&domain), &reads, &[READING, DIAGNOSTICS]);
    let mut bridge = fleet.bridge(&file, "in ROS domain");
    let mut peer = Peer::start(&python, &domain);
    peer.subscribe("/r1/joulebus/reading_w", "Float64");
    peer.subscribe("/r2/joulebus/reading_w", "Float64");
    peer.subscribe("/diagnostics", "DiagnosticArray");
    let battery =
        json!({"voltage": 4.0, "current": 1.0, "percentage": 80.0, "power_supply_status": 0});
    peer.publish("/fleet/r1/odom", "Odometry", &json!({"twist": {"twist": twist()}}));
    peer.order(&json!({
        "say": "/fleet/r2/cmd_vel", "type": "TwistStamped", "fields": {"twist": twist()}, "best_effort": true,
    }));
    for robot in 1..=2 {
        peer.publish(&format!("/fleet/r{robot}/battery"), "BatteryState", &battery);
        let topic = format!("/r{robot}/joulebus/reading_w");
        peer.wait_for(&topic, 0, |document| is_near(&document["data"], 4.0));
        peer.wait_for("/diagnostics", 0, |document| {
            let robot = status(document, &format!("joulebus: r{robot}"));
            robot["level"] != 3 && text_of(robot, "power_w").parse::<f64>().is_ok()
        });
    }
    let report = bridge.stop().json();
    assert!(unmapped(&report).is_empty(), "{report}");
    worker.stop();
}

/// Same as [`text`], for a scope with a variable of that name.
fn text_of<'d>(status: &'d Value, key: &str) -> &'d str {
    text(status, key)
}

#[test]
fn hostile_messages_are_counted_by_reason_and_disturb_no_other_robot() {
    let Some(python) = cyclonedds() else { return };
    let (fleet, domain) = (Fleet::new(), RosDomain::take());
    let mut worker = fleet.worker();
    let mut bridge = fleet.bridge(&file(&domain), "in ROS domain");
    let mut peer = Peer::start(&python, &domain);
    // No other participant has the same topic with another type.
    let mut hostile = Peer::start(&python, &domain);
    let mut huge = Peer::start(&python, &domain);
    peer.subscribe("/r1/joulebus/reading_w", "Float64");
    hostile.publish("/fleet/r2/battery_state", "Truncated", &json!({}));
    huge.publish("/fleet/r3/battery_state", "Huge", &json!({}));
    let (nan, inf) = (json!({"linear": {"x": "nan"}}), json!({"angular": {"z": "inf"}}));
    peer.publish("/fleet/r2/cmd_vel", "Twist", &nan);
    peer.publish("/fleet/r3/cmd_vel", "Twist", &inf);
    let cells = vec![4.0; 20_000];
    let long = json!({"voltage": 4.0, "cell_voltage": cells});
    peer.order(
        &json!({"say": "/fleet/r2/battery_state", "type": "BatteryState", "fields": long, "hz": 5}),
    );
    peer.publish("/fleet/r1/battery_state", "BatteryState", &discharging());
    for expected in ["not_cdr: r2", "not_cdr: r3", "not_finite: linear.x of r2", "too_long: r2"] {
        let seen = |bridge: &Child| bridge.errors().contains(expected);
        joulebus_testkit::eventually(expected, || seen(&bridge));
    }
    // Bytes that are no DDS at all, sent to the ports of the bridge.
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    for turn in 0..2_000_u32 {
        let mut bytes: Vec<u8> = (0..turn % 600).map(|at| (at * 31 + turn * 7) as u8).collect();
        if turn % 2 == 0 {
            bytes.splice(0..0, *b"RTPS\x02\x04\x01\x10");
        }
        let port = domain.first_port() + (turn % 2) as u16;
        let _ = socket.send_to(&bytes, ("127.0.0.1", port));
    }
    let from = peer.received();
    peer.wait_for("/r1/joulebus/reading_w", from, |document| is_near(&document["data"], 4.4));
    let ended = bridge.end();
    assert_eq!(ended.exit_code(), 3, "{ended:?}");
    worker.stop();
}

#[test]
fn a_worker_and_a_talker_that_are_killed_are_found_again() {
    let Some(python) = cyclonedds() else { return };
    let (fleet, domain) = (Fleet::new(), RosDomain::take());
    let mut worker = fleet.worker();
    let mut bridge = fleet.bridge(&file(&domain), "in ROS domain");
    let mut listener = Peer::start(&python, &domain);
    listener.subscribe("/r1/joulebus/reading_w", "Float64");
    listener.subscribe("/diagnostics", "DiagnosticArray");
    let mut talker = Peer::start(&python, &domain);
    talker.publish("/fleet/r1/battery_state", "BatteryState", &discharging());
    let is_read = |document: &Value| is_near(&document["data"], 4.4);
    listener.wait_for("/r1/joulebus/reading_w", 0, is_read);
    // The robot has no commands, on which the other tests' forecasts depend.
    listener.wait_for("/diagnostics", 0, |document| {
        let robot = status(document, "joulebus: r1");
        text(robot, "quality_detail") == "NoCommand" && text(robot, "power_w") == "unknown"
    });

    worker.kill();
    let document = listener.wait_for("/diagnostics", 0, |document| {
        status(document, "joulebus: worker of lab")["level"] == 2
    });
    let robot = status(&document, "joulebus: r1");
    // On a busy machine the same reading may have come for so long that it is reported as well.
    let message = robot["message"].as_str().unwrap();
    assert!(robot["level"] == 3 && message.starts_with("worker gone"), "{robot}");
    let from = listener.received();
    let mut worker = fleet.worker();
    listener.wait_for("/r1/joulebus/reading_w", from, is_read);

    talker.kill();
    let from = listener.received();
    listener.wait_for("/diagnostics", from, |document| {
        let robot = status(document, "joulebus: r1");
        robot["level"] == 3 && robot["message"].as_str().is_some_and(|text| text.contains("NoData"))
    });
    let mut talker = Peer::start(&python, &domain);
    let other =
        json!({"voltage": 4.0, "current": -1.2, "percentage": 0.8, "power_supply_status": 2});
    talker.publish("/fleet/r1/battery_state", "BatteryState", &other);
    listener.wait_for("/r1/joulebus/reading_w", 0, |document| is_near(&document["data"], 4.8));
    let report = bridge.stop().json();
    assert!(unmapped(&report).is_empty(), "{report}");
    worker.stop();
    assert_eq!(fleet.stale_files(), Vec::<PathBuf>::new());
}

#[test]
fn a_robot_on_its_charger_charges_and_its_batterys_power_is_no_load() {
    let Some(python) = cyclonedds() else { return };
    let (fleet, domain) = (Fleet::new(), RosDomain::take());
    let mut worker = fleet.worker();
    let mut bridge = fleet.bridge(&file(&domain), "in ROS domain");
    let mut peer = Peer::start(&python, &domain);
    peer.subscribe("/r1/joulebus/budget", "BatteryState");
    peer.subscribe("/r1/joulebus/reading_w", "Float64");
    let charging =
        json!({"voltage": 4.0, "current": 2.0, "percentage": 0.5, "power_supply_status": 1});
    peer.publish("/fleet/r1/battery_state", "BatteryState", &charging);
    let budget =
        peer.wait_for("/r1/joulebus/budget", 0, |document| document["power_supply_status"] == 1);
    assert_eq!(budget["header"]["frame_id"], "r1");
    peer.publish("/fleet/r1/battery_state", "BatteryState", &discharging());
    peer.wait_for("/r1/joulebus/budget", 0, |document| document["power_supply_status"] == 2);
    let mut readings = Vec::new();
    peer.wait_for("/r1/joulebus/reading_w", 0, |document| {
        readings.push(document["data"].clone());
        is_near(&document["data"], 4.4)
    });
    let is_load = |reading: &Value| reading.is_null() || is_near(reading, 4.4);
    assert!(readings.iter().all(is_load), "{readings:?}");
    bridge.stop();
    worker.stop();
}

/// Starts a subscriber that keeps one message, as most do of a latched topic, beside a bridge.
fn late_subscriber(start: impl FnOnce(&RosDomain) -> Peer) {
    const ROBOTS: u32 = 100;
    let (fleet, domain) = (Fleet::with_robots(ROBOTS), RosDomain::take());
    let mut worker = fleet.worker();
    let mut source = fleet.source(ROBOTS);
    let rarely = format!("{DIAGNOSTICS}\ntopic = \"/rarely\"\nevery_s = 3000");
    let file = file_with(&keys(&domain), &[COMMANDS], &[DIAGNOSTICS, &rarely]);
    let file = file.replace("1-3", &format!("0-{}", ROBOTS - 1));
    let mut bridge = fleet.bridge(&file, "in ROS domain");
    let mut late = start(&domain);
    for topic in ["/rarely", "/diagnostics"] {
        let (kind, depth) = ("DiagnosticArray", 1);
        late.order(&json!({"hear": topic, "type": kind, "transient_local": true, "depth": depth}));
    }
    let all = |array: &Value| array["status"].as_array().unwrap().len() == ROBOTS as usize + 1;
    late.wait_for("/rarely", 0, all);
    // More than 64 KiB, when each robot has its values.
    late.wait_for("/diagnostics", 0, |array| {
        let is_known = |status: &Value| text(status, "power_w").parse::<f64>().is_ok();
        array["status"].as_array().unwrap().iter().filter(|status| is_known(status)).count()
            == ROBOTS as usize
    });
    // Nobody publishes commands.
    bridge.wait_for_line("no message of a robot has come by DDS");
    let ended = bridge.end();
    assert!(!ended.errors().contains("Cannot remove Writer"), "{ended:?}");
    let report = ended.json();
    assert_eq!(report["not_written"], 0, "{report}");
    source.end();
    worker.stop();
}

#[test]
fn late_subscribers_of_cyclone_dds_get_the_diagnostics_of_every_robot_in_one_message() {
    let Some(python) = cyclonedds() else { return };
    late_subscriber(|domain| Peer::start(&python, domain));
}

#[test]
#[ignore = "needs ROS 2, which tools/ros2.sh makes in minutes"]
fn late_subscribers_of_nodes_of_ros_2_get_the_diagnostics_of_every_robot_in_one_message() {
    let Some(ros2) = ros2() else { return };
    late_subscriber(|domain| Peer::node(&ros2, domain));
}

#[test]
fn a_reader_that_stops_reading_does_not_hold_up_the_others() {
    let Some(python) = cyclonedds() else { return };
    let (fleet, domain) = (Fleet::new(), RosDomain::take());
    let mut worker = fleet.worker();
    let mut bridge = fleet.bridge(&file(&domain), "in ROS domain");
    let mut stopped = Peer::start(&python, &domain);
    stopped.subscribe("/r1/joulebus/reading_w", "Float64");
    stopped.subscribe("/diagnostics", "DiagnosticArray");
    let mut peer = Peer::start(&python, &domain);
    peer.subscribe("/r1/joulebus/reading_w", "Float64");
    peer.publish("/fleet/r1/battery_state", "BatteryState", &discharging());
    let is_read = |document: &Value| is_near(&document["data"], 4.4);
    stopped.wait_for("/r1/joulebus/reading_w", 0, is_read);
    stopped.signal(Signal::STOP);
    // Longer than its lease, at ten messages a second.
    let from = peer.received();
    let mut count = 0;
    peer.wait_for("/r1/joulebus/reading_w", from, |_| {
        count += 1;
        count >= 150
    });
    stopped.signal(Signal::CONT);
    let report = bridge.stop().json();
    assert_eq!(report["not_written"], 0, "{report}");
    worker.stop();
}

#[test]
fn a_file_is_checked_without_a_fleet_or_a_peer() {
    let (fleet, domain) = (Fleet::new(), RosDomain::take());
    let check = |text: &str| {
        let mut command = fleet.command(text);
        command.arg("--check");
        Child::spawn("bridge", command).wait()
    };
    let good = check(&file(&domain));
    assert_eq!(good.exit_code(), 0, "{good:?}");
    let ros2 = &good.json()["ros2"];
    assert_eq!(ros2["domain_id"], domain.id);
    assert_eq!(ros2["reads"][0], "/fleet/{robot}/battery_state (sensor_msgs/msg/BatteryState)");
    assert_eq!(ros2["writes"][4], "/diagnostics (diagnostic_msgs/msg/DiagnosticArray)");
    let simulated = check(&file(&domain).replace("networks", "use_sim_time = true\nnetworks"));
    assert_eq!(simulated.json()["ros2"]["reads"][2], "/clock (rosgraph_msgs/msg/Clock)");
    let bad = check(&file(&domain).replace("/fleet/{robot}/cmd_vel", "fleet/{robot}/cmd_vel"));
    assert_eq!(bad.exit_code(), 2);
    assert!(bad.errors().contains("no topic of ROS 2"), "{bad:?}");
    assert_eq!(fleet.stale_files(), Vec::<PathBuf>::new());
}
