//! The Foxglove server, as a client meets it.

use std::net::TcpStream;
use std::time::Duration;

use joulebus_capture::{Message, MessageKind};
use rustix::process::Signal;
use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest as _;
use tungstenite::{Message as Frame, WebSocket};

use crate::fleet::{Fleet, Program, code, json, stderr};

/// Nothing here takes that long; a test that hangs fails instead.
const PATIENCE: Duration = Duration::from_secs(60);

fn connect(address: &str) -> WebSocket<TcpStream> {
    let stream = TcpStream::connect(address.strip_prefix("ws://").unwrap()).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let mut request = address.into_client_request().unwrap();
    let protocol = "foxglove.sdk.v1".parse().unwrap();
    request
        .headers_mut()
        .insert("sec-websocket-protocol", protocol);
    tungstenite::client(request, stream).unwrap().0
}

/// The next message that is JSON and of the kind `op`.
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

#[test]
fn a_client_sees_the_channels_and_a_message_it_can_decode() {
    let fleet = Fleet::new();
    let worker = fleet.worker();
    let source = Program::start(fleet.joulebus("publish sim --robots 3 --name serve"));
    let mut serve = Program::start(fleet.joulebus("serve --foxglove --port 0 --format json"));
    serve.wait_for_stderr("\n");
    let said = serve.stderr();
    let (_, address) = said.split_once("serving fleet cli at ").unwrap();
    let address = address.lines().next().unwrap().to_owned();
    assert!(address.starts_with("ws://127.0.0.1:"), "{address}");

    let mut client = connect(&address);
    let info = next_json(&mut client, "serverInfo");
    assert_eq!(info["name"], "joulebus cli");
    let topic = MessageKind::Forecasts.topic("cli", 0);
    let channel = loop {
        let advertised = next_json(&mut client, "advertise");
        let channels = advertised["channels"].as_array().unwrap().clone();
        if let Some(channel) = channels
            .into_iter()
            .find(|channel| channel["topic"] == topic)
        {
            break channel;
        }
    };
    assert_eq!(channel["encoding"], "protobuf");
    assert_eq!(channel["schemaName"], MessageKind::Forecasts.schema());
    let subscribe = json!({
        "op": "subscribe",
        "subscriptions": [{ "id": 7, "channelId": channel["id"] }],
    });
    client.send(Frame::text(subscribe.to_string())).unwrap();
    let forecasts = loop {
        let Frame::Binary(bytes) = client.read().unwrap() else {
            continue;
        };
        // Opcode 1, our number, the log time, then the message as in a capture.
        if bytes[0] != 1 {
            continue;
        }
        assert_eq!(bytes[1..5], 7_u32.to_le_bytes());
        let Message::Forecasts(_, forecasts) =
            Message::decode(MessageKind::Forecasts, &bytes[13..]).unwrap()
        else {
            panic!("no forecasts");
        };
        if !forecasts.is_empty() {
            break forecasts;
        }
    };
    assert!(
        forecasts.iter().all(|forecast| forecast.robot < 3),
        "{forecasts:?}"
    );
    drop(client);

    let served = serve.end(Signal::INT);
    assert_eq!(code(&served), 0, "{}", stderr(&served));
    assert!(json(&served)["messages"].as_u64().unwrap() > 0);
    source.end(Signal::TERM);
    worker.end(Signal::TERM);
    assert!(fleet.stale_files().is_empty());
}
