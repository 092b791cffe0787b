//! Outlooks, questions about plans and acknowledgements of alarms over ROS 2, with each peer.

use std::path::PathBuf;

use joulebus_testkit::{Child, free_port};
use serde_json::{Value, json};

use super::peer::{Peer, RosDomain, cyclonedds, hash, ros2};
use super::{BATTERY, COMMANDS, discharging, file_with, keys, rmw, twist};
use crate::fleet::{Fleet, unmapped};

/// A bridge's file with services and outlooks.
fn file(keys: &str) -> String {
    let services = "what_if = \"/joulebus/what_if\"\nacknowledge = \"/joulebus/acknowledge\"";
    file_with(&format!("{keys}\n{services}"), &[BATTERY, COMMANDS], &["what = \"outlook\""])
}

/// Calls a service until a response is as expected.
fn call(
    peer: &mut Peer,
    (name, kind): (&str, &str),
    request: &Value,
    is_it: impl FnMut(&Value) -> bool,
) -> Value {
    let from = peer.received();
    peer.order(&json!({"call": name, "type": kind, "fields": request}));
    let response = peer.wait_for(name, from, is_it);
    peer.order(&json!({"hush": name}));
    response
}

/// Robot r1 is published, its outlook received, its plan's cost asked for, and its alarm
/// acknowledged.
fn outlook_questions_and_acknowledgement(peer: &mut Peer) {
    let ask = ("/joulebus/what_if", "WhatIf");
    let (battery, commands) = ("/fleet/r1/battery_state", "/fleet/r1/cmd_vel");
    peer.publish(battery, "BatteryState", &discharging());
    peer.publish(commands, "Twist", &twist());
    peer.subscribe("/r1/joulebus/outlook", "Outlook");
    let outlook =
        peer.wait_for("/r1/joulebus/outlook", 0, |outlook| outlook["energy_j"][3].is_number());
    assert_eq!(outlook["horizon_s"], json!([1.0, 10.0, 60.0, 300.0]), "{outlook}");
    assert_eq!(outlook["header"]["frame_id"], "r1", "{outlook}");
    let energy_j = outlook["energy_j"].as_array().unwrap().iter();
    let energy_j: Vec<f64> = energy_j.map(|energy_j| energy_j.as_f64().unwrap()).collect();
    assert!(energy_j.is_sorted() && energy_j[0] > 0.0, "{outlook}");
    assert!(outlook["usable_j"].as_f64().unwrap() > 0.0, "{outlook}");

    let idle = json!({"robots": ["r1"], "idle_s": 60.0});
    let response =
        call(peer, ask, &idle, |response| response["answers"][0]["energy_j"].is_number());
    let answer = &response["answers"][0];
    assert_eq!((&response["refused"], &answer["robot"]), (&json!(""), &json!("r1")));
    assert!(response["tick"].as_u64().unwrap() > 0, "{response}");
    assert!((answer["duration_s"].as_f64().unwrap() - 60.0).abs() < 1.0, "{response}");
    let point = |x: f64| json!({"x": x, "y": 0.0, "z": 0.0});
    let path = json!({
        "robots": ["r1"], "path": [point(0.0), point(1.0)], "return_to_start": true, "coverage": 0.8,
    });
    // Responses to earlier calls may come late.
    let is_other =
        |response: &Value| response["answers"][0]["duration_s"].as_f64().is_some_and(|s| s < 50.0);
    let response = call(peer, ask, &path, is_other);
    let answer = &response["answers"][0];
    assert!(answer["energy_hi_j"].as_f64() > answer["energy_lo_j"].as_f64(), "{response}");
    let commands_of = json!({
        "robots": ["r1"], "candidates": 2, "period_s": 1.0, "v_mps": [0.0, 0.1], "omega_radps": [0.0, 0.0],
    });
    let response =
        call(peer, ask, &commands_of, |response| response["answers"][1]["energy_j"].is_number());
    assert_eq!(response["answers"].as_array().map(Vec::len), Some(2), "{response}");
    let along = |path: Value| json!({"robots": ["r1"], "path": path});
    let far = |x: &str| along(json!([point(0.0), {"x": 1.0, "y": x, "z": 0.0}]));
    let long = |count: u32| along((0..count).map(|at| point(f64::from(at) * 0.1)).collect());
    for (request, expected) in [
        (json!({"robots": ["r9"], "idle_s": 1.0}), "there is no robot \"r9\""),
        (json!({"robots": ["r1"]}), "give one of path, idle_s"),
        (json!({"robots": ["r1"], "idle_s": 1.0, "coverage": 2.0}), "coverage"),
        (json!({"robots": ["r1"], "idle_s": "nan"}), "a duration of NaN s"),
        (far("nan"), "y_m of point 1 is NaN"),
        (far("-inf"), "y_m of point 1 is -inf"),
        (long(2_000), "6001 values: the worker answers at most 4096"),
        (long(10_000), "the request is longer than 65536 bytes"),
    ] {
        let is_it = |response: &Value| response["refused"].as_str().unwrap().contains(expected);
        let refused = call(peer, ask, &request, is_it);
        assert_eq!(refused["answers"], json!([]), "{refused}");
    }
    call(peer, ask, &idle, |response| response["answers"][0]["energy_j"].is_number());

    let acknowledge = ("/joulebus/acknowledge", "Acknowledge");
    let request = json!({"robot": "r1", "alarm": "NoData", "by": "Ada"});
    let refused = call(peer, acknowledge, &request, |response| response["success"] == false);
    assert!(refused["message"].as_str().unwrap().contains("is not raised"), "{refused}");
    for topic in [battery, commands] {
        peer.order(&json!({"hush": topic}));
    }
    let taken = call(peer, acknowledge, &request, |response| response["success"] == true);
    assert_eq!(taken["message"], "", "{taken}");
}

/// Ends a bridge. It has counted the request that was too long, and nothing else.
fn end(bridge: &mut Child) {
    let report = bridge.end().exits(3).json();
    let reasons: Vec<&Value> = unmapped(&report).iter().map(|message| &message["reason"]).collect();
    assert_eq!(json!([report["not_written"], reasons]), json!([0, ["too_long"]]), "{report}");
}

#[test]
fn outlooks_questions_and_acknowledgements_are_exchanged_with_cyclone_dds() {
    let Some(python) = cyclonedds() else { return };
    let (fleet, domain) = (Fleet::new(), RosDomain::take());
    let mut worker = fleet.worker();
    let mut bridge = fleet.bridge(&file(&keys(&domain)), "2 services");
    let mut peer = Peer::start(&python, &domain);
    outlook_questions_and_acknowledgement(&mut peer);
    end(&mut bridge);
    worker.stop();
    assert_eq!(fleet.stale_files(), Vec::<PathBuf>::new());
}

#[test]
#[ignore = "needs ROS 2, which tools/ros2.sh makes in minutes"]
fn outlooks_questions_and_acknowledgements_are_exchanged_with_nodes_of_ros_2() {
    let Some(ros2) = ros2() else { return };
    let (fleet, domain) = (Fleet::new(), RosDomain::take());
    let mut worker = fleet.worker();
    let mut bridge = fleet.bridge(&file(&keys(&domain)), "2 services");
    let mut peer = Peer::node(&ros2, &domain);
    outlook_questions_and_acknowledgement(&mut peer);
    peer.order(&json!({"graph": "joulebus_bridge"}));
    let of = peer.wait_for("graph", 0, |graph| graph["writes"]["/r3/joulebus/outlook"].is_array());
    let kinds = &of["services"]["/joulebus/what_if"];
    assert_eq!(*kinds, json!(["joulebus_msgs/srv/WhatIf"]), "{of}");
    end(&mut bridge);
    worker.stop();
    assert_eq!(fleet.stale_files(), Vec::<PathBuf>::new());
}

#[test]
fn outlooks_questions_and_acknowledgements_are_exchanged_over_zenoh() {
    let Some(python) = cyclonedds() else { return };
    let (fleet, address) = (Fleet::new(), format!("tcp/127.0.0.1:{}", free_port()));
    let mut worker = fleet.worker();
    let mut peer = Peer::within(&python, &address);
    let mut bridge = rmw::bridge(&fleet, &address, &file("domain_id = 7"), "2 services");
    outlook_questions_and_acknowledgement(&mut peer);
    let token = format!(
        "/SS/%/%/joulebus_bridge/%joulebus%what_if/joulebus_msgs::srv::dds_::WhatIf_/{}/::,10:,:,:,,",
        hash("WhatIf")
    );
    peer.wait_for("@", 0, |note| note["token"].as_str().unwrap().ends_with(&token));
    end(&mut bridge);
    worker.stop();
    assert_eq!(fleet.stale_files(), Vec::<PathBuf>::new());
}
