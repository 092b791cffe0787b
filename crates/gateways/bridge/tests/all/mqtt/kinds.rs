//! Brokers of MQTT 5 and 3.1.1, as they are run: with long messages, with access lists, and silent.

use std::fs;
use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::thread;
use std::time::Duration;

use joulebus_testkit::{Child, MemoryGroup, as_in_docker, eventually, remove};
use rumqttc::QoS;
use serde_json::Value;

use super::broker::{Broker, mosquitto};
use super::{Robots, count, file, is_forecast};
use crate::fleet::Fleet;

/// The bridge's file with a version of MQTT.
fn file_of(broker: &Broker, version: &str) -> String {
    file(broker).replace("[mqtt]", &format!("[mqtt]\nversion = \"{version}\""))
}

/// The most memory that a process has had, bytes.
fn peak_bytes(pid: u32) -> u64 {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let mut lines = status.lines();
    let peak = lines.find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
    let kilobytes: u64 = peak.trim().trim_end_matches(" kB").parse().unwrap();
    kilobytes << 10
}

#[test]
fn messages_of_any_length_are_counted_and_skipped_while_other_robots_are_forecast() {
    let Some(program) = mosquitto() else { return };
    for version in ["3.1.1", "5"] {
        let (fleet, broker) = (Fleet::new(), Broker::start(&program, "allow_anonymous true"));
        let mut worker = fleet.worker();
        let long = |megabytes: usize| vec![b'7'; megabytes << 20];
        let keeper = broker.client("keeper", "kept");
        let keep = |topic: &str, payload: Vec<u8>| {
            let kept = keeper.client.publish(topic, QoS::AtLeastOnce, true, payload);
            kept.unwrap();
        };
        keep("fleet/r1/power", long(40));
        keep("kept", Vec::from("1"));
        keeper.wait_for("kept", |_| true);
        let mut bridge = fleet.bridge(&file_of(&broker, version), "connected to ");
        let listener = broker.client("listener", "jb/#");
        let robots = Robots::start(broker.client("robots", "nothing").client);
        listener.wait_for("jb/lab/r3/forecast", is_forecast);
        listener.send("fleet/r2/power", long(5));
        for _ in 0..2 {
            listener.send("fleet/r2/power", long(40));
        }
        // A broker of MQTT 5 keeps what is longer than 16 MiB.
        let least = if version == "5" { 1 } else { 4 };
        listener.wait_for("jb/lab/bridge", |status| count(status, "too_long") >= least);
        listener.forget();
        listener.wait_for("jb/lab/r3/forecast", is_forecast);
        listener.wait_for("jb/lab/r2/forecast", |document| {
            is_forecast(document) && document["quality"] != "OpenLoop"
        });
        drop(robots);
        let peak = peak_bytes(bridge.pid());
        assert!(peak < 40 << 20, "{peak} bytes");
        let ended = bridge.end();
        assert_eq!(ended.exit_code(), 3, "{ended:?}");
        assert_eq!(count(&ended.json(), "too_long"), least, "{ended:?}");
        assert!(!ended.errors().contains("not connected"), "{ended:?}");
        worker.stop();
    }
}

#[test]
fn a_bridge_needs_nothing_that_docker_forbids() {
    let Some(program) = mosquitto() else { return };
    let (fleet, broker) = (Fleet::new(), Broker::start(&program, "allow_anonymous true"));
    let Some(command) = as_in_docker(&fleet.command(&file(&broker))) else { return };
    let mut worker = fleet.worker();
    let mut bridge = Child::spawn("bridge", command);
    let listener = broker.client("listener", "jb/#");
    let robots = Robots::start(broker.client("robots", "nothing").client);
    listener.wait_for("jb/lab/r2/forecast", is_forecast);
    drop(robots);
    bridge.end().exits(0);
    worker.stop();
}

#[test]
fn the_next_bridge_works_when_the_kernel_has_killed_one_for_memory() {
    let Some(program) = mosquitto() else { return };
    let Some(group) = MemoryGroup::new(160 << 20) else { return };
    let (fleet, broker) = (Fleet::new(), Broker::start(&program, "allow_anonymous true"));
    let mut worker = fleet.worker();
    let listener = broker.client("listener", "jb/#");
    let _robots = Robots::start(broker.client("robots", "nothing").client);
    for is_killed in [true, false] {
        listener.forget();
        let command = group.first_to_die(&fleet.command(&file(&broker)));
        let mut bridge = Child::spawn("bridge", command);
        listener.wait_for("jb/lab/r2/forecast", is_forecast);
        if is_killed {
            group.exhaust();
            assert_eq!(bridge.wait().signal(), Some(9));
        } else {
            bridge.end().exits(0);
        }
    }
    worker.stop();
}

#[test]
fn a_bridge_whose_shared_memory_is_removed_reports_it_and_exits_with_1() {
    let Some(program) = mosquitto() else { return };
    let (fleet, broker) = (Fleet::new(), Broker::start(&program, "allow_anonymous true"));
    let mut worker = fleet.worker();
    let mut bridge = fleet.bridge(&file(&broker), "connected to ");
    fleet.stale_files().iter().for_each(|path| remove(path));
    let ended = bridge.wait();
    assert!(ended.code() == Some(1) && ended.errors().contains("RemoveIPC"), "{ended:?}");
    assert_eq!(worker.wait().code(), Some(1));
}

#[test]
fn what_a_killed_bridge_has_written_expires_where_the_broker_knows_that() {
    let Some(program) = mosquitto() else { return };
    for version in ["5", "3.1.1"] {
        let (fleet, broker) = (Fleet::new(), Broker::start(&program, "allow_anonymous true"));
        let mut worker = fleet.worker();
        let mut bridge = fleet.bridge(&file_of(&broker, version), "connected to ");
        let listener = broker.client("listener", "jb/#");
        let robots = Robots::start(broker.client("robots", "nothing").client);
        listener.wait_for("jb/lab/r1/budget", Value::is_object);
        listener.wait_for("jb/lab/r1/alarms", Value::is_object);
        drop(robots);
        bridge.kill();
        let offline = |status: &Value| status["state"] == "offline";
        listener.wait_for("jb/lab/bridge", offline);
        let mut clients = 0;
        // What the broker still keeps is sent before what is published after the subscription.
        let mut kept = || {
            clients += 1;
            let later = broker.client(&format!("later-{clients}"), "jb/#");
            later.send("jb/now", "1");
            later.wait_for("jb/now", |_| true);
            later.wait_for("jb/lab/bridge", offline);
            later.wait_for("jb/lab/r1/alarms", |_| true);
            let messages = later.messages();
            messages.iter().any(|message| message.topic == "jb/lab/r1/budget")
        };
        if version == "5" {
            eventually("the budget expires", || !kept());
        } else {
            assert!(kept(), "3.1.1 knows no expiry");
        }
        worker.stop();
    }
}

#[test]
fn what_a_broker_refuses_is_reported_with_its_reason() {
    let Some(program) = mosquitto() else { return };
    let folder = tempfile::tempdir().unwrap();
    let rules = folder.path().join("rules");
    fs::write(&rules, "topic readwrite fleet/#\ntopic readwrite jb/lab/bridge\n").unwrap();
    let more = format!("allow_anonymous true\nacl_file {}", rules.display());
    let (fleet, broker) = (Fleet::new(), Broker::start(&program, &more));
    let mut worker = fleet.worker();
    let mut bridge = fleet.bridge(&file(&broker), "connected to ");
    let robots = Robots::start(broker.client("robots", "nothing").client);
    let line = bridge.wait_for_line("refused: writing jb/lab/");
    assert!(line.contains(": not authorized"), "{line}");
    drop(robots);
    bridge.kill();
    worker.stop();
}

/// An action of a broker on a connection, after the bridge's introduction.
enum Act {
    Close,
    Send(&'static [u8]),
    /// Sends this, and then nothing until the bridge ends the connection.
    Hold(&'static [u8]),
    /// Sends this, and then answers pings, but acknowledges nothing.
    Pong(&'static [u8]),
}

/// The broker takes the connection.
const TAKEN_BY_3: &[u8] = &[0x20, 2, 0, 0];
const TAKEN_BY_5: &[u8] = &[0x20, 3, 0, 0, 0];

/// Serves one connection after the other. Returns the version that each bridge asked for.
fn serve(listener: &TcpListener, acts: &[Act]) -> Vec<u8> {
    let serve = |act: &Act| {
        let (mut bridge, _) = listener.accept().unwrap();
        let mut head = [0; 2];
        bridge.read_exact(&mut head).unwrap();
        assert!(head[1] < 128, "a length of one byte");
        let mut body = vec![0; head[1].into()];
        bridge.read_exact(&mut body).unwrap();
        match act {
            Act::Close => {}
            Act::Send(bytes) => bridge.write_all(bytes).unwrap(),
            Act::Hold(bytes) => {
                bridge.write_all(bytes).unwrap();
                drain(&mut bridge);
            }
            Act::Pong(bytes) => {
                bridge.write_all(bytes).unwrap();
                while let Some(kind) = packet(&mut bridge) {
                    if kind == 0xc0 {
                        bridge.write_all(&[0xd0, 0]).unwrap();
                    }
                }
            }
        }
        // After length and name of the protocol.
        body[6]
    };
    acts.iter().map(serve).collect()
}

/// The first byte of the next packet. `None`: the connection has ended.
fn packet(from: &mut TcpStream) -> Option<u8> {
    let mut byte = [0];
    from.read_exact(&mut byte).ok()?;
    let [kind] = byte;
    let (mut length, mut place) = (0_u64, 0);
    loop {
        from.read_exact(&mut byte).ok()?;
        length |= u64::from(byte[0] & 0x7f) << place;
        place += 7;
        if byte[0] & 0x80 == 0 {
            break;
        }
    }
    let body = std::io::copy(&mut from.take(length), &mut std::io::sink()).ok()?;
    (body == length).then_some(kind)
}

fn drain(from: &mut TcpStream) {
    let mut bytes = [0; 4_096];
    while from.read(&mut bytes).is_ok_and(|count| count > 0) {}
}

/// A broker with these acts, and the begin of the file of a bridge to it.
fn scripted<const COUNT: usize>(acts: [Act; COUNT]) -> (thread::JoinHandle<Vec<u8>>, String) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let broker = thread::spawn(move || serve(&listener, &acts));
    let text = format!("[robots]\nr = 1\n[mqtt]\nbroker = \"127.0.0.1:{port}\"\n");
    (broker, text)
}

#[test]
fn brokers_that_do_not_know_mqtt_5_or_send_nonsense_are_tried_again_until_one_serves() {
    let fleet = Fleet::new();
    let acts = [
        // Without a word: 3.1.1 at once, then 5 again.
        Act::Close,
        Act::Send(b"\x20\x02\x00"),
        // No MQTT.
        Act::Send(b"\0HTTP/1.1 400 Bad Request\r\n\r\n"),
        // A message before the answer, and the longest packet that there can be.
        Act::Send(b"\x30\x03\x00\x01a\x20\xff\xff\xff\x7f"),
        // Busy, by MQTT 5.
        Act::Send(b"\x20\x03\x00\x89\x00"),
        // Taken, the subscription refused, and ended for another client of the same name.
        Act::Send(b"\x20\x03\0\0\0\x90\x04\0\x01\0\x87\xe0\x02\x8e\0"),
        // An unknown version, by MQTT 3.1.1.
        Act::Send(b"\x20\x02\x00\x01"),
        Act::Hold(TAKEN_BY_3),
    ];
    let (broker, text) = scripted(acts);
    let text = format!("{text}vda5050 = [{{ topic = \"a/{{robot}}\" }}]\n");
    let mut bridge = fleet.bridge(&text, "unsupported protocol version");
    bridge.wait_for_line("connected to ");
    let ended = bridge.end();
    assert_eq!(ended.exit_code(), 3, "a subscription was refused: {ended:?}");
    let errors = ended.errors();
    joulebus_testkit::assert_contains(
        &errors,
        [
            "trying MQTT 3.1.1",
            "it ended the connection without an answer",
            "it does not speak MQTT: ",
            "it refuses the connection: server busy",
            "refused: reading a/+: not authorized",
            "session taken over. Another client has the same `mqtt.client_id`",
        ],
    );
    assert_eq!(broker.join().unwrap(), [5, 4, 5, 5, 5, 5, 5, 4], "{errors}");
}

#[test]
fn a_broker_of_mqtt_5_that_restarts_is_not_taken_for_an_older_one() {
    let fleet = Fleet::new();
    let (broker, text) = scripted([
        // Starting, behind a proxy that first closes and then explains.
        Act::Close,
        Act::Send(b"HTTP/1.1 502 Bad Gateway\r\n\r\n"),
        Act::Send(TAKEN_BY_5),
        // Restarting.
        Act::Close,
        Act::Hold(TAKEN_BY_5),
    ]);
    let text = format!("{text}vda5050 = [{{ topic = \"a/{{robot}}\" }}]\n");
    let mut bridge = fleet.bridge(&text, "trying MQTT 3.1.1");
    bridge.wait_for_line("connected to ");
    bridge.wait_for_line("without an answer");
    bridge.wait_for_line("connected to ");
    let errors = bridge.stop().errors();
    assert_eq!(broker.join().unwrap(), [5, 4, 5, 5, 5], "{errors}");
    assert_eq!(errors.matches("trying MQTT 3.1.1").count(), 1, "{errors}");
}

#[test]
fn a_port_of_tls_is_named_and_not_taken_for_an_older_version() {
    let fleet = Fleet::new();
    let (broker, text) = scripted([Act::Send(b"\x15\x03\x01\x00\x02\x02\x46")]);
    let text = format!("{text}vda5050 = [{{ topic = \"a/{{robot}}\" }}]\n");
    let ended = Child::spawn("bridge", fleet.command(&text)).wait();
    assert_eq!(ended.exit_code(), 1, "{ended:?}");
    joulebus_testkit::assert_contains(&ended.errors(), ["it speaks TLS: add [mqtt.tls]"]);
    assert_eq!(broker.join().unwrap(), [5]);
}

#[test]
fn brokers_that_fall_silent_or_acknowledge_nothing_are_given_up_and_what_is_left_is_lost() {
    let fleet = Fleet::new();
    let mut worker = fleet.worker();
    let (broker, text) = scripted([
        // It wants a packet every 600 s only.
        Act::Hold(b"\x20\x06\0\0\x03\x13\x02\x58"),
        Act::Pong(TAKEN_BY_5),
        // It takes one message at a time.
        Act::Pong(b"\x20\x06\0\0\x03\x21\0\x01"),
    ]);
    let text = format!(
        "{text}keep_alive_s = 5\n\
         write = [{{ what = \"status\", topic = \"jb/bridge\", every_s = 0.1 }}]\n"
    );
    let mut bridge = fleet.bridge(&text, "connected to ");
    bridge.wait_for_line("it has sent nothing for 5 s");
    bridge.wait_for_line("has not acknowledged a message for 5 s");
    bridge.wait_for_line("connected to ");
    thread::sleep(Duration::from_secs(1));
    let ended = bridge.end();
    assert_eq!(ended.exit_code(), 3, "{ended:?}");
    let report = ended.json();
    assert!(report["not_written"].as_u64().unwrap() >= 3, "{report}");
    assert_eq!(broker.join().unwrap(), [5; 3]);
    worker.stop();
}
