//! An HTTP client, as small as the tests need it.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{Ipv4Addr, SocketAddrV4, TcpStream};

use joulebus_testkit::{PATIENCE, eventually};
use rustix::net::{AddressFamily, SocketType, bind, connect, socket};
use serde_json::Value;

#[derive(Debug)]
pub(crate) struct Response {
    pub(crate) status: u16,
    pub(crate) headers: Vec<(String, String)>,
    pub(crate) body: Vec<u8>,
}

impl Response {
    pub(crate) fn header(&self, name: &str) -> Option<&str> {
        let found = self.headers.iter().find(|(found, _)| found == name);
        found.map(|(_, value)| value.as_str())
    }

    pub(crate) fn text(&self) -> String {
        String::from_utf8(self.body.clone()).unwrap()
    }

    pub(crate) fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|error| panic!("{error}: {self:?}"))
    }
}

pub(crate) fn dial(address: &str) -> TcpStream {
    let stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream
}

/// Connects as another client, from another address of this host.
pub(crate) fn dial_from(from: Ipv4Addr, address: &str) -> TcpStream {
    let socket = socket(AddressFamily::INET, SocketType::STREAM, None).unwrap();
    bind(&socket, &SocketAddrV4::new(from, 0)).unwrap();
    let to: SocketAddrV4 = address.parse().unwrap();
    connect(&socket, &to).unwrap();
    let stream = TcpStream::from(socket);
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream
}

/// Sends a request whose head ends the connection after it.
pub(crate) fn send(address: &str, head: &str, body: &[u8]) -> Response {
    send_on(dial(address), head, body)
}

pub(crate) fn send_on(mut stream: TcpStream, head: &str, body: &[u8]) -> Response {
    let length = body.len();
    let head = format!("{head}\r\nConnection: close\r\nContent-Length: {length}\r\n\r\n");
    stream.write_all(head.as_bytes()).unwrap();
    stream.write_all(body).unwrap();
    read(stream)
}

pub(crate) fn get(address: &str, path: &str) -> Response {
    send(address, &format!("GET {path} HTTP/1.1\r\nHost: {address}"), b"")
}

/// The answer to a question. Asks again if the server has not answered in time.
pub(crate) fn get_json(address: &str, path: &str) -> Value {
    let response = answered(path, || get(address, path));
    assert_eq!(response.status, 200, "{path}: {}", response.text());
    response.json()
}

/// True if an alarm of a robot is raised.
pub(crate) fn has_alarm(address: &str, robot: u32, alarm: &str) -> bool {
    let response = get(address, &format!("/api/v1/robots/{robot}"));
    response.status == 200
        && response.json()["alarms"]
            .as_array()
            .is_some_and(|alarms| alarms.iter().any(|raised| raised == alarm))
}

/// The answer to a question about a plan. Asks again if the server finds no fresh frame of the
/// worker in time.
pub(crate) fn what_if(address: &str, question: &str) -> Response {
    let head = format!(
        "POST /api/v1/what_if HTTP/1.1\r\nHost: {address}\r\nContent-Type: application/json"
    );
    answered("an answer about a plan", || send(address, &head, question.as_bytes()))
}

/// The answer to an acknowledgement.
pub(crate) fn acknowledge(address: &str, body: &str, header: &str) -> Response {
    post(address, "/api/v1/alarms/acknowledge", body, header)
}

pub(crate) fn post(address: &str, path: &str, body: &str, header: &str) -> Response {
    let head = format!("POST {path} HTTP/1.1\r\nHost: {address}\r\n{header}");
    answered(path, || send(address, &head, body.as_bytes()))
}

/// The first response that is not 503, which a busy server answers.
pub(crate) fn answered(what: &str, mut ask: impl FnMut() -> Response) -> Response {
    let mut found = None;
    eventually(what, || {
        found = Some(ask()).filter(|response| response.status != 503);
        found.is_some()
    });
    found.unwrap()
}

/// The response of a connection that is closed after it.
fn read(stream: TcpStream) -> Response {
    let mut reader = BufReader::new(stream);
    let (status, headers) = head(&mut reader);
    let mut body = Vec::new();
    reader.read_to_end(&mut body).unwrap();
    Response { status, headers, body }
}

fn head(reader: &mut BufReader<TcpStream>) -> (u16, Vec<(String, String)>) {
    let status = line(reader);
    let status = status.split(' ').nth(1).unwrap_or_else(|| panic!("no status in {status:?}"));
    let mut headers = Vec::new();
    loop {
        let line = line(reader);
        let Some((name, value)) = line.split_once(':') else {
            return (status.parse().unwrap(), headers);
        };
        headers.push((name.to_ascii_lowercase(), value.trim().to_owned()));
    }
}

fn line(reader: &mut BufReader<TcpStream>) -> String {
    let mut line = String::new();
    reader.read_line(&mut line).unwrap();
    line.trim_end().to_owned()
}

/// A stream of events, and what they add up to.
pub(crate) struct Events {
    reader: BufReader<TcpStream>,
    text: String,
    seq: u64,
    /// The view with all deltas applied, as a page keeps it.
    pub(crate) view: Value,
}

impl Events {
    pub(crate) fn open(address: &str, query: &str) -> Self {
        Self::read(dial(address), address, query)
    }

    pub(crate) fn read(mut stream: TcpStream, address: &str, query: &str) -> Self {
        let head = format!("GET /api/v1/stream?{query} HTTP/1.1\r\nHost: {address}\r\n\r\n");
        stream.write_all(head.as_bytes()).unwrap();
        let mut reader = BufReader::new(stream);
        let (status, headers) = self::head(&mut reader);
        assert_eq!(status, 200, "{headers:?}");
        assert!(
            headers
                .iter()
                .any(|(name, value)| name == "content-type" && value == "text/event-stream")
        );
        let mut events = Self { reader, text: String::new(), seq: 0, view: Value::Null };
        events.next();
        events
    }

    /// Applies the next event.
    pub(crate) fn next(&mut self) {
        let block = loop {
            if let Some((block, rest)) = self.text.split_once("\n\n") {
                let (block, rest) = (block.to_owned(), rest.to_owned());
                self.text = rest;
                if !block.starts_with(':') {
                    break block;
                }
            } else {
                let length = usize::from_str_radix(&line(&mut self.reader), 16).unwrap();
                assert!(length > 0, "the stream has ended");
                let mut chunk = vec![0; length + 2];
                self.reader.read_exact(&mut chunk).unwrap();
                self.text.push_str(std::str::from_utf8(&chunk[..length]).unwrap());
            }
        };
        let (event, data) = block.split_once('\n').unwrap();
        let data: Value = serde_json::from_str(data.strip_prefix("data: ").unwrap()).unwrap();
        self.seq += 1;
        assert_eq!(data["seq"], self.seq);
        match event {
            "event: view" => self.view = data,
            "event: delta" => self.apply(&data),
            _ => panic!("{event}"),
        }
    }

    fn apply(&mut self, delta: &Value) {
        let view = &mut self.view;
        merge(&mut view["fleet"], &delta["fleet"]);
        match delta.get("robot") {
            Some(robot) if robot.is_object() => merge(&mut view["robot"], robot),
            Some(robot) => view["robot"] = robot.clone(),
            None => {}
        }
        if let Some(raised) = delta["alarms"].get("raised") {
            view["alarms"]["raised"] = raised.clone();
        }
        if let Some(changes) = delta["alarms"]["changes"].as_array() {
            let all = view["alarms"]["changes"].as_array_mut().unwrap();
            all.splice(0..0, changes.iter().cloned());
        }
        let robots = &delta["robots"];
        if robots.is_null() {
            return;
        }
        for name in ["total", "matched", "from"] {
            view["robots"][name] = robots[name].clone();
        }
        let mut rows: Vec<Value> = view["robots"]["robots"].as_array().unwrap().clone();
        let mut named: serde_json::Map<String, Value> =
            rows.iter().map(|row| (row["robot"].to_string(), row.clone())).collect();
        for (robot, change) in robots["rows"].as_object().into_iter().flatten() {
            merge(named.entry(robot.clone()).or_insert(Value::Null), change);
        }
        let order: Vec<Value> = match robots.get("order") {
            Some(order) => order.as_array().unwrap().clone(),
            None => rows.iter().map(|row| row["robot"].clone()).collect(),
        };
        rows.clear();
        rows.extend(order.iter().map(|robot| named[&robot.to_string()].clone()));
        view["robots"]["robots"] = rows.into();
    }

    /// Reads events until `condition` holds of the view.
    pub(crate) fn until(&mut self, what: &str, condition: impl Fn(&Value) -> bool) {
        let end = std::time::Instant::now() + PATIENCE;
        while !condition(&self.view) {
            assert!(std::time::Instant::now() < end, "{what}: {}", self.view);
            self.next();
        }
    }
}

/// Replaces the values of `into` that `change` has.
fn merge(into: &mut Value, change: &Value) {
    if into.is_null() {
        *into = Value::Object(serde_json::Map::new());
    }
    for (name, value) in change.as_object().into_iter().flatten() {
        into[name] = value.clone();
    }
}
