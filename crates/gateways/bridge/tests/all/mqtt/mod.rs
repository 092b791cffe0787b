//! A bridge to a real Mosquitto with a real worker. Without a broker the tests log that they skip,
//! and with CI=true they fail.

pub(crate) mod broker;
mod kinds;
mod secure;

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::fleet::{Fleet, unmapped};
use broker::{Broker, Listener, mosquitto};
use joulebus_testkit::{Child, assert_contains, eventually};
use rumqttc::{Client, QoS};
use serde_json::{Value, json};

/// A bridge's file that reads powers in mW and commands of robots 1 to 3, and writes all topics.
fn file(broker: &Broker) -> String {
    let address = broker.address();
    format!(
        r#"
        [robots]
        "r{{id}}" = "1-3"
        [mqtt]
        broker = "{address}"
        [[mqtt.read]]
        topic = "fleet/{{robot}}/power"
        fields = {{ power = {{ at = "/monitor/power", unit = "mW" }}, soc = {{ at = "soc", unit = "%" }} }}
        [[mqtt.read]]
        topic = "commands"
        robot_at = "who"
        fields = {{ v = {{ at = "v", unit = "mm/s" }}, omega = {{ at = "w", unit = "deg/s", negate = true }} }}
        [[mqtt.write]]
        what = "forecast"
        topic = "jb/{{fleet}}/{{robot}}/forecast"
        every_s = 0.1
        [[mqtt.write]]
        what = "budget"
        topic = "jb/{{fleet}}/{{robot}}/budget"
        every_s = 0.5
        [[mqtt.write]]
        what = "alarms"
        topic = "jb/{{fleet}}/{{robot}}/alarms"
        every_s = 0.1
        [[mqtt.write]]
        what = "alarm_changes"
        topic = "jb/{{fleet}}/alarms"
        [[mqtt.write]]
        what = "status"
        topic = "jb/{{fleet}}/bridge"
        every_s = 0.2
        "#
    )
}

/// Sends readings and commands of robots 1 to 3 until it is dropped.
struct Robots {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Robots {
    fn start(client: Client) -> Self {
        let stop = Arc::<AtomicBool>::default();
        let stopped = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            for turn in 0_u32.. {
                if stopped.load(Ordering::Relaxed) {
                    return;
                }
                for robot in 1..=3 {
                    let power = 4_000.0 + 100.0 * f64::from(robot) + f64::from(turn % 7);
                    let reading = json!({"monitor": {"power": power}, "soc": 80}).to_string();
                    let command = json!({"who": format!("r{robot}"), "v": 100, "w": 10});
                    for (topic, payload) in [
                        (format!("fleet/r{robot}/power"), reading),
                        ("commands".to_owned(), command.to_string()),
                    ] {
                        let _ = client.try_publish(topic, QoS::AtMostOnce, false, payload);
                    }
                }
                std::thread::sleep(Duration::from_millis(33));
            }
        });
        Self { stop, thread: Some(thread) }
    }
}

impl Drop for Robots {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

fn is_forecast(document: &Value) -> bool {
    document["power_w"].is_number() && document["lo_w"].is_number()
}

#[test]
fn readings_as_json_are_forecast_and_forecasts_budgets_and_alarms_are_published() {
    let Some(program) = mosquitto() else { return };
    let fleet = Fleet::new();
    let broker = Broker::start(&program, "allow_anonymous true");
    let mut worker = fleet.worker();
    let mut bridge = fleet.bridge(&file(&broker), "connected to ");
    let listener = broker.client("listener", "jb/#");
    let robots = Robots::start(broker.client("robots", "nothing").client);
    for robot in 1..=3 {
        let topic = format!("jb/lab/r{robot}/forecast");
        let document = listener.wait_for(&topic, is_forecast).json();
        let reading_w = document["reading_w"].as_f64().unwrap();
        assert!((4.0..4.4).contains(&reading_w), "{document}");
        assert_eq!(document["robot"], robot);
        assert_eq!(document["name"], format!("r{robot}"));
    }
    let budget = |document: &Value| {
        document["soc"].as_f64().is_some_and(|soc| soc < 0.99) && document["drawn_j"].is_number()
    };
    listener.wait_for("jb/lab/r2/budget", budget);
    listener.wait_for("jb/lab/r3/budget", |_| true);
    // A late subscriber gets the retained messages, and then new ones.
    let later = broker.client("later", "jb/#");
    eventually("what is kept", || {
        let messages = later.messages();
        let mut budgets = messages.iter().filter(|message| message.topic == "jb/lab/r3/budget");
        budgets.any(|budget| budget.retained)
    });
    let online = later.wait_for("jb/lab/bridge", |document| document["state"] == "online");
    assert!(online.json()["worker"].is_string());
    listener.forget();
    drop(robots);
    let raised = |document: &Value| {
        document["alarm"] == "NoData" && document["change"] == "raised" && document["name"] == "r1"
    };
    let change = listener.wait_for("jb/lab/alarms", raised);
    assert_eq!(change.json()["robot"], 1);
    assert!(!change.retained, "{change:?}");
    listener.wait_for("jb/lab/r1/alarms", |document| {
        document["alarms"] == json!(["NoData"]) && document["level"] == "stale"
    });
    // The documents of robots that leave the fleet are deleted from the broker.
    eventually("no budget is kept", || {
        let mut messages = listener.messages().into_iter();
        messages.any(|message| message.topic == "jb/lab/r1/budget" && message.payload.is_empty())
    });
    worker.kill();
    listener.wait_for("jb/lab/alarms", |document| {
        document["alarm"] == "WorkerGone" && document["robot"].is_null()
    });
    listener.wait_for("jb/lab/bridge", |document| document["worker"] == "gone");
    let report = bridge.stop().json();
    listener.wait_for("jb/lab/bridge", |document| document["state"] == "offline");
    assert!(unmapped(&report).is_empty(), "{report}");
    assert_eq!(report["not_written"], 0, "{report}");
    let samples = report["published"]["samples"].as_u64();
    assert!(samples.unwrap() > 0, "{report}");
    fleet.worker().stop();
    assert_eq!(fleet.stale_files(), Vec::<PathBuf>::new());
}

#[test]
fn a_broker_that_is_killed_and_started_again_is_joined_again() {
    let Some(program) = mosquitto() else { return };
    let fleet = Fleet::new();
    let mut broker = Broker::start(&program, "allow_anonymous true");
    let mut worker = fleet.worker();
    let mut bridge = fleet.bridge(&file(&broker), "connected to ");
    let listener = broker.client("listener", "jb/#");
    let robots = Robots::start(broker.client("robots", "nothing").client);
    listener.wait_for("jb/lab/r1/forecast", is_forecast);
    listener.wait_for("jb/lab/r1/alarms", |document| document["alarms"] == json!([]));
    for _ in 0..2 {
        broker.kill();
        bridge.wait_for_line("not connected to ");
        broker.restart();
        bridge.wait_for_line("connected to ");
        listener.forget();
        // Readings arrive again, so the bridge has subscribed again.
        listener.wait_for("jb/lab/r1/forecast", |document| {
            is_forecast(document) && document["quality"] != "OpenLoop"
        });
        // The broker retains the documents again.
        let later = broker.client("later", "jb/#");
        for topic in ["jb/lab/r2/budget", "jb/lab/r2/alarms", "jb/lab/bridge"] {
            later.wait_for(topic, |_| true);
        }
    }
    drop(robots);
    // The broker reports a killed bridge.
    bridge.kill();
    listener.wait_for("jb/lab/bridge", |document| {
        document["state"] == "offline" && document["bridge"] == "bridge"
    });
    worker.stop();
}

/// The number of unmapped messages with a reason.
fn count(report: &Value, reason: &str) -> u64 {
    let lines = report["unmapped"].as_array().map_or(&[][..], Vec::as_slice);
    let own = lines.iter().filter(|line| line["reason"] == reason);
    own.map(|line| line["count"].as_u64().unwrap()).sum()
}

/// Sends messages that no robot should send.
fn attack(client: &Listener) {
    let deep = "[".repeat(60_000);
    let (huge, power) = ("7".repeat(5 << 20), "fleet/r1/power");
    for (topic, payload) in [
        (power, huge.as_str()),
        (power, &deep),
        (power, r#"{"monitor": {"power": NaN}}"#),
        (power, r#"{"monitor": {"power": 1e300}}"#),
        (power, r#"{"monitor": {"power": "4000"}}"#),
        (power, r#"{"monitor": [[[]]]}"#),
        ("fleet/in\u{202e}truder/power", r#"{"monitor": {"power": 1}}"#),
        ("commands", r#"{"v": 1}"#),
        ("commands", r#"{"who": "r9", "v": 1}"#),
        ("commands", ""),
    ] {
        client.send(topic, payload);
    }
    client.send(power, vec![0xff, 0xfe, 0x00]);
    for number in 0..2_000 {
        client.send(&format!("fleet/flood-{number}/power"), "{}");
    }
    // Values of the right type that are impossible for a robot. The worker refuses them.
    for _ in 0..20 {
        let payload = r#"{"monitor": {"power": 1e12}, "soc": 900}"#;
        client.send("fleet/r2/power", payload);
    }
}

#[test]
fn hostile_messages_are_counted_and_named_and_harm_nobody() {
    let Some(program) = mosquitto() else { return };
    let fleet = Fleet::new();
    let broker = Broker::start(&program, "allow_anonymous true");
    let mut worker = fleet.worker();
    let keeper = broker.client("keeper", "nothing");
    let (topic, kept) = ("fleet/r1/power", r#"{"monitor": {"power": 9000}}"#);
    let sent = keeper.client.publish(topic, QoS::AtLeastOnce, true, kept);
    sent.unwrap();
    let mut bridge = fleet.bridge(&file(&broker), "connected to ");
    let listener = broker.client("listener", "jb/#");
    let robots = Robots::start(broker.client("robots", "nothing").client);
    listener.wait_for("jb/lab/r3/forecast", is_forecast);
    attack(&broker.client("intruder", "nothing"));
    let flooded = |document: &Value| count(document, "unknown_robot") >= 2_003;
    listener.wait_for("jb/lab/bridge", flooded);
    listener.forget();
    let calm = listener.wait_for("jb/lab/r3/forecast", is_forecast).json();
    let reading_w = calm["reading_w"].as_f64().unwrap();
    assert!((4.2..4.4).contains(&reading_w), "{calm}");
    listener.wait_for("jb/lab/r2/forecast", |document| {
        is_forecast(document) && document["reading_w"].as_f64().unwrap() < 5.0
    });
    assert!(worker.is_running() && bridge.is_running());
    drop(robots);
    let ended = bridge.end();
    assert_eq!(ended.exit_code(), 3, "{ended:?}");
    assert!(!ended.errors().contains('\u{202e}'), "{}", ended.errors());
    assert_contains(&ended.errors(), ["not mapped: fleet/{robot}/power: unknown_robot: "]);
    let report = ended.json();
    for (reason, least) in [
        ("too_long", 1),
        ("not_json", 3),
        ("not_finite", 1),
        ("wrong_type", 1),
        // NaN, as some programs write what they do not know, among them.
        ("nothing_mapped", 3),
        ("unknown_robot", 2_003),
        ("retained", 1),
    ] {
        assert!(count(&report, reason) >= least, "{reason}: {report}");
    }
    let names = report["unmapped"]
        .as_array()
        .unwrap()
        .iter()
        .map(|line| line["names"].as_array().unwrap().len());
    assert!(names.max().unwrap() <= 16, "{report}");
    worker.stop();
}

#[test]
fn vehicles_of_vda_5050_report_their_battery_and_velocity() {
    let Some(program) = mosquitto() else { return };
    let fleet = Fleet::new();
    let broker = Broker::start(&program, "allow_anonymous true");
    let mut worker = fleet.worker();
    let address = broker.address();
    let mut bridge = fleet.bridge(
        &format!(
            r#"
        [bridge]
        reading_holds_s = 30
        silent_after_s = 60
        [robots]
        "0001" = 4
        [mqtt]
        broker = "{address}"
        vda5050 = [{{ topic = "uagv/v2/KIT/{{robot}}/state" }},
                   {{ topic = "uagv/v3/KIT/{{robot}}/state", current = "discharge_negative" }}]
        write = [{{ what = "budget", topic = "jb/{{robot}}/budget", every_s = 0.1 }}]
        "#
        ),
        "connected to ",
    );
    let listener = broker.client("listener", "jb/#");
    let mut state = json!({
        "headerId": 1, "timestamp": "2026-11-23T04:00:00.00Z", "version": "2.0.0", "manufacturer": "KIT",
        "serialNumber": "0001", "orderId": "", "driving": true, "operatingMode": "AUTOMATIC",
        "velocity": {"vx": 0.1, "vy": 0.0, "omega": 0.2},
        "batteryState": {"batteryCharge": 63.0, "batteryVoltage": 24.0, "charging": true},
        "errors": [], "safetyState": {"eStop": "NONE", "fieldViolation": false},
    });
    let soc =
        |document: &Value| document["soc"].as_f64().is_some_and(|soc| (soc - 0.63).abs() < 0.1);
    // A state is not retained. One sent before the bridge subscribes is lost.
    let mut sent = 0;
    let mut send = |topic: &str, state: &Value, is_charging: bool, mean_w: Option<f64>| {
        eventually("the state is published", || {
            sent += 1;
            listener.send(topic, state.to_string());
            std::thread::sleep(Duration::from_millis(100));
            let messages = listener.messages();
            let budgets = messages.iter().filter(|message| message.topic == "jb/0001/budget");
            budgets.map(broker::Message::json).any(|document| {
                let drawn_w = document["mean_power_w"].as_f64();
                let is_mean = mean_w.is_none_or(|mean_w| {
                    drawn_w.is_some_and(|drawn_w| (drawn_w - mean_w).abs() < 0.01)
                });
                document["charging"] == is_charging
                    && soc(&document)
                    && document["robot"] == 4
                    && is_mean
            })
        });
    };
    let of_2 = "uagv/v2/KIT/0001/state";
    send(of_2, &state, true, None);
    state["batteryState"]["charging"] = json!(false);
    send(of_2, &state, false, None);
    // Version 3 has the current: −0.15 A at 24 V are 3.6 W drawn.
    let of_3 = "uagv/v3/KIT/0001/state";
    state["version"] = json!("3.0.0");
    state.as_object_mut().unwrap().remove("batteryState");
    state["powerSupply"] = json!({
        "stateOfCharge": 63.0, "batteryVoltage": 24.0, "batteryCurrent": -0.15, "charging": false,
    });
    send(of_3, &state, false, Some(3.6));
    state["version"] = json!("4.0.0");
    listener.send(of_3, state.to_string());
    bridge.wait_for_line("unknown_version");
    // The state that was refused is lost.
    let ended = bridge.end();
    assert_eq!(ended.code(), Some(3), "{ended:?}");
    let report = ended.json();
    // Every received state was counted once: exactly three if no state was sent again.
    let observations = report["observations"].as_u64().unwrap();
    assert!((3..=sent).contains(&observations), "{sent}: {report}");
    assert!(has(&report, "unknown_version", "\"4.0.0\" of 0001"), "{report}");
    worker.stop();
}

/// True if a message of the robot was not mapped for a reason.
fn has(report: &Value, reason: &str, robot: &str) -> bool {
    let lines = report["unmapped"].as_array().map_or(&[][..], Vec::as_slice);
    let mut lines = lines.iter().filter(|line| line["reason"] == reason);
    lines.any(|line| {
        let names = line["names"].as_array().unwrap();
        names.iter().any(|name| name == robot)
    })
}

#[test]
fn a_wrong_password_ends_the_start_and_a_right_one_is_taken() {
    let Some(program) = mosquitto() else { return };
    let folder = tempfile::tempdir().unwrap();
    let passwords = folder.path().join("passwords");
    let mut make = Command::new("mosquitto_passwd");
    make.arg("-b").arg("-c").arg(&passwords).args(["bridge", "right"]);
    assert!(make.status().unwrap().success());
    let more = format!("allow_anonymous false\npassword_file {}", passwords.display());
    let (fleet, broker) = (Fleet::new(), Broker::start(&program, &more));
    let secret = broker.file("secret");
    let login = format!(
        "broker = \"{}\"\nusername = \"bridge\"\npassword_file = \"{}\"",
        broker.address(),
        secret.display()
    );
    let text = file(&broker).replace(&format!("broker = \"{}\"", broker.address()), &login);
    for (password, code) in [("wrong", 1), ("right", 0)] {
        fs::write(&secret, password).unwrap();
        fs::set_permissions(&secret, PermissionsExt::from_mode(0o600)).unwrap();
        let mut bridge = Child::spawn("bridge", fleet.command(&text));
        if code == 0 {
            bridge.wait_for_line("connected to ");
            bridge.stop();
        } else {
            let ended = bridge.wait();
            assert_eq!(ended.exit_code(), code, "{ended:?}");
            assert!(
                ended.errors().contains("refuses the connection: not authorized. Check `username`")
                    && !ended.errors().contains(password),
                "{ended:?}"
            );
        }
    }
    fs::set_permissions(&secret, PermissionsExt::from_mode(0o644)).unwrap();
    let ended = Child::spawn("bridge", fleet.command(&text)).wait();
    assert_eq!(ended.exit_code(), 2, "{ended:?}");
}

#[test]
fn a_file_is_checked_without_a_fleet_or_a_broker() {
    let fleet = Fleet::new();
    let text = "[robots]\nr = 1\n[mqtt]\nbroker = \"127.0.0.1:9\"\nvda5050 = [{ topic = \"a/{robot}/state\" }]\n";
    let check = |text: &str| {
        let mut command = fleet.command(text);
        command.arg("--check");
        Child::spawn("bridge", command).wait()
    };
    let good = check(text);
    assert_eq!(
        (good.exit_code(), &good.json()["reads"]),
        (0, &json!(["a/{robot}/connection", "a/{robot}/state"]))
    );
    let bad = check(&text.replace("broker", "brokers"));
    assert_eq!(bad.exit_code(), 2);
    assert!(bad.errors().contains("bridge.toml:4") && bad.text().is_empty(), "{bad:?}");
    assert_eq!(fleet.stale_files(), Vec::<PathBuf>::new());
}
