//! A bridge whose file has a broker and a ROS 2 domain: a robot's power comes over the one and its
//! commands over the other. Without Mosquitto and the other vendor's DDS the test logs that it
//! skips, and with CI=true it fails.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::fleet::{Fleet, unmapped};
use crate::mqtt::broker::{Broker, mosquitto};
use crate::ros2::peer::{Peer, RosDomain, cyclonedds};
use rumqttc::QoS;
use serde_json::{Value, json};

fn file(broker: &Broker, domain: &RosDomain) -> String {
    let (address, id) = (broker.address(), domain.id);
    format!(
        r#"
        [robots]
        "r{{id}}" = "1-3"
        [mqtt]
        broker = "{address}"
        [[mqtt.read]]
        topic = "fleet/{{robot}}/power"
        fields = {{ power = {{ at = "", unit = "mW" }} }}
        [[mqtt.write]]
        what = "forecast"
        topic = "jb/{{robot}}/forecast"
        every_s = 0.1
        [ros2]
        domain_id = {id}
        networks = ["127.0.0.1"]
        [[ros2.read]]
        topic = "/fleet/{{robot}}/cmd_vel"
        type = "geometry_msgs/msg/Twist"
        [[ros2.write]]
        what = "value"
        value = "power_w"
        every_s = 1
        "#
    )
}

/// True if the document has a forecast for a command, and the reading before it.
fn is_forecast(document: &Value) -> bool {
    let reading_w = document["reading_w"].as_f64();
    document["power_w"].is_number() && reading_w.is_some_and(|watts| (watts - 4.4).abs() < 1e-3)
}

#[test]
fn power_of_a_broker_and_commands_of_ros_2_make_one_robot_that_is_published_to_both() {
    let (Some(program), Some(python)) = (mosquitto(), cyclonedds()) else {
        return;
    };
    let (fleet, domain) = (Fleet::new(), RosDomain::take());
    let mut broker = Broker::start(&program, "allow_anonymous true");
    let mut worker = fleet.worker();
    let mut bridge = fleet.bridge(&file(&broker, &domain), "connected to ");
    let listener = broker.client("listener", "jb/#");
    let power = broker.client("robots", "nothing").client;
    let stop = Arc::<AtomicBool>::default();
    let stopped = Arc::clone(&stop);
    let robots = std::thread::spawn(move || {
        while !stopped.load(Ordering::Relaxed) {
            let _ = power.try_publish("fleet/r1/power", QoS::AtMostOnce, false, "4400");
            std::thread::sleep(Duration::from_millis(33));
        }
    });
    let mut peer = Peer::start(&python, &domain);
    peer.subscribe("/r1/joulebus/power_w", "Float64");
    // Power without a command yields no forecast.
    listener.wait_for("jb/r1/forecast", |document| {
        document["reading_w"].is_number() && document["power_w"].is_null()
    });
    let command = json!({"linear": {"x": 0.1}, "angular": {"z": 0.2}});
    peer.publish("/fleet/r1/cmd_vel", "Twist", &command);
    listener.wait_for("jb/r1/forecast", is_forecast);
    let is_number = |document: &Value| document["data"].is_number();
    peer.wait_for("/r1/joulebus/power_w", 0, is_number);

    // One connection goes on while the other is lost.
    broker.kill();
    bridge.wait_for_line("not connected to ");
    let from = peer.received();
    peer.wait_for("/r1/joulebus/power_w", from, |_| true);
    broker.restart();
    bridge.wait_for_line("connected to ");
    listener.forget();
    listener.wait_for("jb/r1/forecast", is_forecast);

    stop.store(true, Ordering::Relaxed);
    robots.join().unwrap();
    let report = bridge.stop().json();
    assert!(unmapped(&report).is_empty(), "{report}");
    assert_eq!(report["robots"], 3, "{report}");
    worker.stop();
    assert_eq!(fleet.stale_files(), Vec::<PathBuf>::new());
}
