//! The Foxglove server from a client's point of view.

use std::fs;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;
use std::thread;
use std::time::Duration;

use joulebus_capture_format::{Message, MessageKind};
use joulebus_config::Config;
use joulebus_predictor_worker::Worker;
use joulebus_publisher::{Pace, Publisher, RobotState};
use joulebus_testkit::{Child, PATIENCE, end_signals, eventually};
use joulebus_wire::Forecasts;
use rustix::process::Signal;
use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest as _;
use tungstenite::{Error, HandshakeError, Message as Frame, WebSocket};

use crate::http::fleet::Fleet;

/// Sends samples of three robots until `stop`.
fn publish(config: &Config, stop: &AtomicBool) {
    let mut publisher = Publisher::with_config(config, "serve").unwrap();
    let mut pace = Pace::every(Duration::from_nanos(33_333_333));
    while !stop.load(Ordering::Relaxed) {
        pace.wait();
        let robots = (0..3).map(|id| RobotState::new(id).command(0.1, 0.2).reading(3.5));
        publisher.publish(robots).unwrap();
    }
}

/// Starts a server. Returns it with its address.
fn start(config: &Path, more: &[&str]) -> (Child, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_joulebus-serve"));
    command.args(["--foxglove", "--port", "0", "--format", "json", "--config"]);
    command.arg(config).args(more).env_remove("JOULEBUS_LOG");
    let mut server = Child::spawn("serve", command);
    let line = server.wait_for_line("serving fleet http at ");
    let address = line.rsplit(' ').next().unwrap();
    assert!(address.starts_with("ws://127.0.0.1:"), "{address}");
    let address = address.to_owned();
    (server.at_drop(Child::stop), address)
}

fn dial(address: &str) -> TcpStream {
    let stream = TcpStream::connect(address.strip_prefix("ws://").unwrap()).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream
}

/// Connects as a page of `origin` or as a program. Returns the status of a refusal, or 0 if the
/// connection ends without one.
fn try_connect(address: &str, origin: Option<&str>) -> Result<WebSocket<TcpStream>, u16> {
    let mut request = address.into_client_request().unwrap();
    let headers = request.headers_mut();
    headers.insert("sec-websocket-protocol", "foxglove.sdk.v1".parse().unwrap());
    if let Some(origin) = origin {
        headers.insert("origin", origin.parse().unwrap());
    }
    match tungstenite::client(request, dial(address)) {
        Ok((client, _)) => Ok(client),
        Err(HandshakeError::Failure(Error::Http(response))) => Err(response.status().as_u16()),
        Err(_) => Err(0),
    }
}

fn connect(address: &str) -> WebSocket<TcpStream> {
    try_connect(address, None).unwrap()
}

/// The next JSON message with the operation `op`.
fn next_json(client: &mut WebSocket<TcpStream>, op: &str) -> Value {
    loop {
        if let Frame::Text(text) = client.read().unwrap() {
            let value: Value = serde_json::from_str(&text).unwrap();
            if value["op"] == op {
                return value;
            }
        }
    }
}

struct StopOnDrop<'a>(&'a AtomicBool);

impl Drop for StopOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

#[test]
fn a_server_that_shows_the_fleet_is_not_listed_as_one_that_records_it() {
    let fleet = Fleet::new();
    let (_server, _) = start(&fleet.path(), &[]);
    let members = joulebus_bus::inspect(&fleet.config.domain().unwrap()).unwrap();
    let names: Vec<_> = members.nodes.iter().map(|node| node.name.as_str()).collect();
    assert_eq!(names, ["foxglove"]);
    assert_ne!(names, [joulebus_capture_recorder::RECORDER]);
}

#[test]
fn a_client_receives_the_channels_and_a_message_it_can_decode() {
    let fleet = Fleet::new();
    let stop = AtomicBool::new(false);
    let (done, finished) = channel();
    thread::scope(|scope| {
        // The threads end with the test, whatever its result.
        let _stopped = StopOnDrop(&stop);
        scope.spawn(|| {
            let mut worker = Worker::open(&fleet.config).unwrap();
            done.send(()).unwrap();
            while !stop.load(Ordering::Relaxed) {
                worker.poll().unwrap();
            }
        });
        finished.recv().unwrap();
        scope.spawn(|| publish(&fleet.config, &stop));
        see_a_forecast(&fleet.path());
    });
}

fn see_a_forecast(config: &Path) {
    let (mut server, address) = start(config, &[]);
    let mut client = connect(&address);
    let info = next_json(&mut client, "serverInfo");
    assert_eq!(info["name"], "joulebus http");
    let kind = MessageKind::of::<Forecasts>();
    let topic = kind.topic("http", 0);
    let channel = loop {
        let advertised = next_json(&mut client, "advertise");
        let channels = advertised["channels"].as_array().unwrap().clone();
        if let Some(channel) = channels.into_iter().find(|channel| channel["topic"] == topic) {
            break channel;
        }
    };
    assert_eq!(channel["encoding"], "protobuf");
    assert_eq!(channel["schemaName"], kind.schema());
    let subscribe = json!({
        "op": "subscribe",
        "subscriptions": [{ "id": 7, "channelId": channel["id"] }],
    });
    client.send(Frame::text(subscribe.to_string())).unwrap();
    let mut tries = 1;
    let forecasts = loop {
        let bytes = match client.read().unwrap() {
            Frame::Binary(bytes) => bytes,
            // The crate foxglove 0.30 advertises a channel before it accepts subscriptions to it.
            Frame::Text(text) if text.contains("Unknown channel ID") => {
                tries += 1;
                assert!(tries < 100, "{text}");
                thread::sleep(Duration::from_millis(10));
                client.send(Frame::text(subscribe.to_string())).unwrap();
                continue;
            }
            _ => continue,
        };
        // Opcode 1, the subscription id, the log time, then the message as in a capture.
        if bytes[0] != 1 {
            continue;
        }
        assert_eq!(bytes[1..5], 7_u32.to_le_bytes());
        let message = Message::decode(kind, &bytes[13..]).unwrap();
        let forecasts = message.into_frame::<Forecasts>().unwrap().rows;
        if !forecasts.is_empty() {
            break forecasts;
        }
    };
    assert!(forecasts.iter().all(|forecast| forecast.robot < 3), "{forecasts:?}");
    drop(client);

    server.signal(Signal::INT);
    let ended = server.wait();
    let report = ended.json();
    // Frames that were overwritten while the server got no processor are lost and reported.
    let code = if report["lost"] == 0 { 0 } else { 3 };
    assert_eq!(ended.code(), Some(code), "{ended:?}");
    assert!(report["messages"].as_u64().unwrap() > 0, "{report}");
}

/// The first bytes of a handshake.
const HALF: &[u8] = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: webso";

/// The response of the server before it closes the connection.
fn farewell(stream: &mut TcpStream) -> String {
    let mut response = Vec::new();
    // A reset also ends the connection.
    let _ = stream.read_to_end(&mut response);
    String::from_utf8(response).unwrap()
}

#[test]
fn connections_do_not_block_the_exit_of_the_server() {
    for signal in end_signals() {
        let fleet = Fleet::new();
        let (mut server, address) = start(&fleet.path(), &[]);
        let _idle = dial(&address);
        let mut half = dial(&address);
        half.write_all(HALF).unwrap();
        // Connected and never reading.
        let _connected = connect(&address);
        server.signal(signal);
        let ended = server.wait();
        assert_eq!(ended.code(), Some(0), "{ended:?}");
    }
}

#[test]
fn an_incomplete_handshake_is_closed() {
    let fleet = Fleet::new();
    let (_server, address) = start(&fleet.path(), &[]);
    let mut idle = dial(&address);
    let mut half = dial(&address);
    half.write_all(HALF).unwrap();
    let mut slow = dial(&address);
    let mut slowly = slow.try_clone().unwrap();
    let dripping = thread::spawn(move || {
        // Byte by byte, as long as they are accepted.
        for byte in b"GET / HTTP/1.1\r\nX: ".iter().chain(std::iter::repeat(&b'x')) {
            if slowly.write_all(&[*byte]).is_err() {
                return;
            }
            thread::sleep(Duration::from_millis(50));
        }
    });
    for stream in [&mut idle, &mut half, &mut slow] {
        let response = farewell(stream);
        // The slow client may have been reset before it read the reason.
        assert!(response.starts_with("HTTP/1.1 408 ") || response.is_empty(), "{response}");
    }
    dripping.join().unwrap();
    let mut long = dial(&address);
    long.write_all(
        &b"GET / HTTP/1.1\r\nX: ".iter().copied().chain([b'x'; 20_000]).collect::<Vec<u8>>(),
    )
    .unwrap();
    let response = farewell(&mut long);
    assert!(response.starts_with("HTTP/1.1 431 ") || response.is_empty(), "{response}");
    // The server serves other clients meanwhile.
    next_json(&mut connect(&address), "serverInfo");
}

#[test]
fn pages_of_this_host_and_of_foxglove_are_served_and_others_refused() {
    let fleet = Fleet::new();
    let allowed = "https://lab.example:8080";
    let (mut server, address) = start(&fleet.path(), &["--allow-origin", allowed]);
    for origin in [
        None,
        Some("http://localhost:3000"),
        Some("http://127.0.0.1:8080"),
        Some("https://app.foxglove.dev"),
        Some(allowed),
    ] {
        let mut client = try_connect(&address, origin).unwrap();
        next_json(&mut client, "serverInfo");
    }
    for origin in ["http://evil.example", "null", "https://app.foxglove.dev.evil.example"] {
        let refused = try_connect(&address, Some(origin)).map(drop);
        assert_eq!(refused, Err(403), "{origin}");
        let response = server.wait_for_line("--allow-origin");
        assert!(response.contains(origin), "{response}");
    }
}

#[test]
fn the_number_of_connections_is_bounded_and_closed_ones_are_freed() {
    let fleet = Fleet::new();
    let (server, address) = start(&fleet.path(), &[]);
    let mut streams: Vec<TcpStream> = (0..200).map(|_| dial(&address)).collect();
    let mut responses = streams.iter_mut().rev().map(farewell);
    let full = responses.find(|response| response.starts_with("HTTP/1.1 503 "));
    assert!(full.is_some(), "200 connections were taken at once");
    let status = fs::read_to_string(format!("/proc/{}/status", server.pid())).unwrap();
    let threads = status.lines().find_map(|line| line.strip_prefix("Threads:"));
    let threads: u32 = threads.unwrap().trim().parse().unwrap();
    assert!(threads < 64 + 40, "{threads} threads");
    // Silent connections are closed, and others are accepted.
    eventually("a place for a client", || {
        try_connect(&address, None).is_ok_and(|mut client| {
            next_json(&mut client, "serverInfo");
            true
        })
    });
    drop(streams);
}
