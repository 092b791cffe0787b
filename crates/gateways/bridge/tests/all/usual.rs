//! The usual topics, without a file.

use std::process::Command;
use std::time::Duration;

use joulebus_testkit::{Child, Ended};
use rumqttc::QoS;

use crate::fleet::{Fleet, unmapped};
use crate::mqtt::broker::{Broker, mosquitto};

fn command(fleet: &Fleet, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_joulebus-bridge"));
    command.args(["--format", "json", "--config"]).arg(fleet.config());
    command.args(arguments).env_remove("JOULEBUS_LOG");
    command
}

fn ended(fleet: &Fleet, arguments: &[&str]) -> Ended {
    Child::spawn("bridge", command(fleet, arguments)).wait()
}

#[test]
fn a_usual_mapping_is_printed_and_its_file_is_the_same() {
    let (fleet, folder) = (Fleet::new(), tempfile::tempdir().unwrap());
    for (usual, topic) in [("ros2", "/{robot}/cmd_vel"), ("mqtt", "fleet/{robot}/power")] {
        let given = [usual, "--robots", "robot{id}=0-4", "--robots", "lifter=7"];
        let checked = ended(&fleet, &[&given[..], &["--check"]].concat());
        assert_eq!(checked.exit_code(), 0, "{checked:?}");
        assert_eq!(checked.json()["robots"], 6);
        for line in ["\"robot{id}\" = \"0-4\"", "\"lifter\" = \"7\"", topic] {
            assert!(checked.errors().contains(line), "{line}: {checked:?}");
        }
        let file = folder.path().join(format!("a {usual}.toml"));
        let file = file.to_str().unwrap();
        let written = ended(&fleet, &[&given[..], &["--write", file]].concat());
        assert_eq!(written.text(), format!("joulebus bridge '{file}'"));
        let again = ended(&fleet, &[file, "--check"]);
        assert_eq!(again.json(), checked.json());
        let refused = ended(&fleet, &[&given[..], &["--write", file]].concat());
        assert_eq!(refused.exit_code(), 1);
        for (options, expected) in [
            (&[usual][..], "--robots 'robot{id}=0-9'"),
            (&[usual, "--robots", "robot7"], "NAME=IDS"),
            (&[usual, "--robots", "robot=0-9"], "robots.robot"),
            (&[file, "--robots", "robot=7"], "joulebus bridge ros2"),
            (&["ros2", "--robots", "r=7", "--broker", "b:1"], "ROS 2 has no broker"),
        ] {
            let refused = ended(&fleet, options);
            assert_eq!(refused.exit_code(), 2, "{refused:?}");
            assert!(refused.errors().contains(expected), "{refused:?}");
        }
    }
}

/// A comment with a setting is that setting, whole on its line: without its `# ` it is in force.
#[test]
fn each_setting_in_a_comment_is_one_when_it_is_uncommented() {
    let (fleet, folder) = (Fleet::new(), tempfile::tempdir().unwrap());
    for usual in ["ros2", "mqtt"] {
        let file = folder.path().join(format!("{usual}.toml"));
        let shown = file.to_str().unwrap();
        let given = [usual, "--robots", "robot{id}=0-4", "--write", shown];
        assert_eq!(ended(&fleet, &given).exit_code(), 0);
        let mut settings = 0;
        let text = std::fs::read_to_string(&file).unwrap();
        let lines = text.lines().map(|line| match line.strip_prefix("# ") {
            Some(setting) if setting.contains(" = ") => {
                let table = setting.parse::<toml::Table>();
                let table = table.unwrap_or_else(|error| panic!("{usual}: {line}: {error}"));
                assert_eq!(table.len(), 1, "{usual}: {line}");
                settings += 1;
                format!("{setting}\n")
            }
            _ => format!("{line}\n"),
        });
        let uncommented: String = lines.collect();
        if usual == "ros2" {
            assert!(uncommented.contains("\nuse_sim_time = true\n"), "{uncommented}");
            assert!(uncommented.contains("\nacknowledge = \"/joulebus/"), "{uncommented}");
            assert!(settings >= 6, "{settings}");
        }
        std::fs::write(&file, uncommented).unwrap();
        let checked = ended(&fleet, &[shown, "--check"]);
        assert_eq!(checked.exit_code(), 0, "{checked:?}");
    }
}

#[test]
fn the_usual_topics_of_mqtt_are_forecast_without_a_file() {
    let Some(program) = mosquitto() else { return };
    let (fleet, broker) = (Fleet::new(), Broker::start(&program, "allow_anonymous true"));
    let mut worker = fleet.worker();
    let address = broker.address();
    let options = ["mqtt", "--robots", "robot3=3", "--broker", &address];
    let mut bridge = Child::spawn("bridge", command(&fleet, &options));
    bridge.wait_for_line("connected to ");
    let listener = broker.client("listener", "joulebus/#");
    let robots = broker.client("robots", "nothing").client;
    let mut turn = 0_u32;
    joulebus_testkit::eventually("a forecast of robot 3", || {
        turn += 1;
        let power_w = 4.0 + f64::from(turn % 7) * 0.01;
        for (topic, payload) in [
            ("fleet/robot3/power", power_w.to_string()),
            ("fleet/robot3/command", r#"{"v": 0.1, "omega": 0.0}"#.to_owned()),
            (
                "uagv/v2/anyone/robot3/state",
                r#"{"batteryState": {"batteryCharge": 80, "charging": false}}"#.to_owned(),
            ),
        ] {
            let _ = robots.try_publish(topic, QoS::AtMostOnce, false, payload);
        }
        std::thread::sleep(Duration::from_millis(33));
        let of_robot = |topic: &str| {
            let messages = listener.messages();
            let last = messages.iter().rfind(|message| message.topic == topic);
            last.map(|message| message.json()).unwrap_or_default()
        };
        of_robot("joulebus/lab/robot3/forecast")["lo_w"].is_number()
            && of_robot("joulebus/lab/robot3/budget")["soc"].as_f64().is_some_and(|soc| soc < 0.95)
    });
    let report = bridge.stop().json();
    assert!(unmapped(&report).is_empty(), "{report}");
    worker.stop();
}
