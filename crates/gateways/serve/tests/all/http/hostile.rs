//! Clients that mean no good, or are broken: the worker and other clients notice nothing.

use std::fs;
use std::io::{Read as _, Write as _};
use std::net::{Ipv4Addr, TcpStream};
use std::time::Duration;

use joulebus_testkit::eventually;
use rustix::process::{Resource, getrlimit, setrlimit};
use serde_json::{Value, json};

use super::client::{Events, dial, dial_from, get, get_json, send};
use super::fleet::Fleet;

/// The worker ticks on, and a client is answered.
fn assert_live(address: &str) {
    let tick = || -> Option<u64> {
        let answer = get(address, "/api/v1/fleet");
        (answer.status == 200).then(|| answer.json())?["tick"].as_u64()
    };
    let mut before = None;
    eventually("the server answers", || {
        before = tick();
        before.is_some()
    });
    eventually("the worker ticks", || tick() > before);
}

/// Malformed requests, chosen by `number`.
fn malformed(number: usize) -> Vec<u8> {
    let host = "Host: localhost\r\n";
    let bytes: Vec<u8> = match number % 12 {
        0 => b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03".to_vec(),
        1 => b"GET\r\n\r\n".to_vec(),
        2 => format!("GET / HTTP/9.9\r\n{host}\r\n").into_bytes(),
        3 => format!("GET /\0 HTTP/1.1\r\n{host}\r\n").into_bytes(),
        4 => format!("G\u{e9}T / HTTP/1.1\r\n{host}\r\n").into_bytes(),
        5 => format!("GET / HTTP/1.1\r\n{host}X: {}\r\n\r\n", "x".repeat(40_000)).into_bytes(),
        6 => format!("GET / HTTP/1.1\r\n{host}{}\r\n", "X: y\r\n".repeat(500)).into_bytes(),
        7 => format!("GET /{} HTTP/1.1\r\n{host}\r\n", "a".repeat(30_000)).into_bytes(),
        8 => format!("POST /api/v1/what_if HTTP/1.1\r\n{host}Content-Length: -1\r\n\r\n{{}}").into_bytes(),
        9 => format!(
            "POST /api/v1/what_if HTTP/1.1\r\n{host}Content-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\nffffffffffffffffff\r\n"
        )
        .into_bytes(),
        10 => format!("GET / HTTP/1.1\r\n{host}\n X: y\r\n\r\n").into_bytes(),
        _ => format!("GET /api/v1/robots?from=%ff&search=%00%f0%28 HTTP/1.1\r\n{host}\r\n").into_bytes(),
    };
    // Flips bits of every other one.
    let mut bytes = bytes;
    if number % 2 == 1 {
        let length = bytes.len();
        bytes[number.wrapping_mul(2_654_435_761) % length] ^= 1 << (number % 8);
    }
    bytes
}

/// Sends and hangs up. Returns the status, if there was one.
fn status_of(address: &str, bytes: &[u8]) -> Option<u16> {
    let mut stream = dial(address);
    // The server may have closed the connection before it has read all.
    let _ = stream.write_all(bytes);
    let _ = stream.shutdown(std::net::Shutdown::Write);
    let mut response = Vec::new();
    let _ = stream.read_to_end(&mut response);
    let response = String::from_utf8_lossy(&response);
    response.split(' ').nth(1)?.parse().ok()
}

#[test]
fn ten_thousand_malformed_requests_leave_worker_and_server_live() {
    let fleet = Fleet::new();
    let mut worker = fleet.worker();
    let _source = fleet.joulebus("publish sim --robots 3");
    let (_server, address) = fleet.serve(&[]);
    let mut statuses = std::collections::BTreeMap::new();
    for number in 0..10_000 {
        let status = status_of(&address, &malformed(number));
        *statuses.entry(status).or_insert(0) += 1;
    }
    // A 5xx is a defect. A flipped bit may leave a request well-formed.
    let defects = statuses.iter().filter(|(status, _)| status.is_some_and(|status| status >= 500));
    assert_eq!(defects.count(), 0, "{statuses:?}");
    assert!(statuses[&Some(400)] > 1_000, "{statuses:?}");
    assert_live(&address);
    assert!(worker.is_running());
}

#[test]
fn a_thousand_idle_connections_keep_nobody_out() {
    let fleet = Fleet::new();
    let _worker = fleet.worker();
    let _source = fleet.joulebus("publish sim --robots 3");
    let (_server, address) = fleet.serve(&[]);
    let mut events = Events::open(&address, "hz=10");
    let mut limits = getrlimit(Resource::Nofile);
    limits.current = limits.maximum;
    setrlimit(Resource::Nofile, limits).unwrap();
    let mut idle: Vec<TcpStream> = Vec::new();
    for number in 0..1_000 {
        let mut stream = dial(&address);
        if number % 2 == 0 {
            // Half a request.
            let _ = stream.write_all(b"GET / HTTP/1.1\r\nHost: loc");
        }
        idle.push(stream);
    }
    assert_live(&address);
    // A stream keeps its place.
    let tick = |view: &Value| view["fleet"]["tick"].as_u64();
    let before = tick(&events.view);
    events.until("the stream goes on", |view| tick(view) > before);
    drop(idle);
    assert_live(&address);
}

#[test]
fn a_request_that_drips_is_closed_and_others_are_served_meanwhile() {
    let fleet = Fleet::new();
    let _worker = fleet.worker();
    let (_server, address) = fleet.serve(&[]);
    let mut slow: Vec<TcpStream> = (0..100).map(|_| dial(&address)).collect();
    let mut dripping = 0;
    let head = b"GET / HTTP/1.1\r\nHost: localhost\r\nX: ";
    eventually("all dripping clients are disconnected", || {
        for stream in &mut slow {
            let byte = head.get(dripping).copied().unwrap_or(b'x');
            let _ = stream.write_all(&[byte]);
        }
        dripping += 1;
        assert_eq!(get(&address, "/healthz").status, 200);
        slow.retain(|stream| {
            let mut stream: &TcpStream = stream;
            stream.set_nonblocking(true).unwrap();
            let ended = match stream.read(&mut [0; 512]) {
                Ok(0) => true,
                Ok(_) => false,
                Err(error) => error.kind() != std::io::ErrorKind::WouldBlock,
            };
            stream.set_nonblocking(false).unwrap();
            !ended
        });
        slow.is_empty()
    });
}

#[test]
fn a_stream_that_is_not_read_is_closed() {
    let fleet = Fleet::new();
    let _worker = fleet.worker();
    let _source = fleet.joulebus("publish sim --robots 20");
    let (server, address) = fleet.serve(&[]);
    eventually("robots", || get_json(&address, "/api/v1/fleet")["totals"]["robots"] == 20);
    let deaf = Events::open(&address, "hz=10&count=200&robot=3");
    let mut read = Events::open(&address, "hz=10&count=1");
    let sockets = || {
        let open = fs::read_dir(format!("/proc/{}/fd", server.pid())).unwrap();
        let links = open.filter_map(|file| fs::read_link(file.unwrap().path()).ok());
        links.filter(|link| link.to_string_lossy().starts_with("socket:")).count()
    };
    let before = sockets();
    // Once the system buffers no more for it. One that is read stays.
    eventually("its connection is closed", || {
        read.next();
        sockets() < before
    });
    drop(deaf);
    assert_live(&address);
}

/// Everything of one kind that a client of `from` can take, held.
type Take = fn(&str, Ipv4Addr) -> Vec<TcpStream>;

/// Sends a request from each of so many connections, and reads no answer.
fn ask_and_wait(address: &str, from: Ipv4Addr, count: usize, request: &str) -> Vec<TcpStream> {
    let request = request.replace("HOST", address);
    let asking = |_| {
        let mut stream = dial_from(from, address);
        // The server may have closed it for another.
        let _ = stream.write_all(request.as_bytes());
        stream
    };
    (0..count).map(asking).collect()
}

fn post_of(path: &str, body: &str) -> String {
    let length = body.len();
    format!(
        "POST {path} HTTP/1.1\r\nHost: HOST\r\nContent-Type: application/json\r\n\
         Content-Length: {length}\r\n\r\n{body}"
    )
}

/// Moments of 20 robots on a path of some minutes: seconds of work.
fn long_question() -> String {
    let robots: Vec<u32> = (0..20).collect();
    let path = json!([{"x_m": 0, "y_m": 0}, {"x_m": 60, "y_m": 0, "speed_mps": 0.2}]);
    json!({"rank": robots, "path": path, "return": "dock"}).to_string()
}

#[test]
fn one_address_takes_all_it_can_of_every_limit_and_another_is_served() {
    const STATEMENT: &str = r#"{"robot": 1, "alarm": "OutOfRange", "by": "ann"}"#;
    let fleet = Fleet::new();
    let _worker = fleet.worker();
    let _source = fleet.joulebus("publish sim --robots 20");
    let (_server, address) = fleet.serve(&[]);
    eventually("robots", || get_json(&address, "/api/v1/fleet")["totals"]["robots"] == 20);
    let limits: [(&str, Take, String, u16); 10] = [
        (
            "idle connections",
            |address, from| ask_and_wait(address, from, 400, "GET / HTTP/1.1\r\nHost: loc"),
            "GET /api/v1/fleet".to_owned(),
            200,
        ),
        (
            "streams",
            |address, from| {
                let stream = "GET /api/v1/stream?hz=0.2&count=1 HTTP/1.1\r\nHost: HOST\r\n\r\n";
                ask_and_wait(address, from, 400, stream)
            },
            "GET /api/v1/stream".to_owned(),
            200,
        ),
        (
            "busy connections",
            |address, from| {
                let stream = "GET /api/v1/stream?hz=0.2&count=1 HTTP/1.1\r\nHost: HOST\r\n\r\n";
                let question = post_of("/api/v1/what_if", &long_question());
                let mut all = ask_and_wait(address, from, 200, stream);
                all.extend(ask_and_wait(address, from, 200, &question));
                all
            },
            "GET /api/v1/fleet".to_owned(),
            200,
        ),
        (
            "questions",
            |address, from| {
                let question = post_of("/api/v1/what_if", &long_question());
                ask_and_wait(address, from, 40, &question)
            },
            post_of("/api/v1/what_if", r#"{"robot": 1, "idle_s": 20}"#),
            200,
        ),
        (
            "statements",
            |address, from| {
                let statement = post_of("/api/v1/alarms/acknowledge", STATEMENT);
                ask_and_wait(address, from, 40, &statement)
            },
            post_of("/api/v1/alarms/acknowledge", STATEMENT),
            409,
        ),
        (
            "capacities",
            |address, from| {
                let capacity = "GET /api/v1/robots/1/capacity HTTP/1.1\r\nHost: HOST\r\n\r\n";
                ask_and_wait(address, from, 40, &capacity.repeat(20))
            },
            post_of("/api/v1/alarms/acknowledge", STATEMENT),
            409,
        ),
        (
            "readings",
            |address, from| {
                let outlook = "GET /api/v1/robots/900/outlook HTTP/1.1\r\nHost: HOST\r\n\r\n";
                ask_and_wait(address, from, 200, outlook)
            },
            "GET /api/v1/robots/1/history".to_owned(),
            200,
        ),
        (
            "bodies that arrive",
            |address, from| {
                let head = post_of("/api/v1/what_if", "").replace("Length: 0", "Length: 1000000");
                ask_and_wait(address, from, 200, &head)
            },
            post_of("/api/v1/what_if", r#"{"robot": 1, "idle_s": 20}"#),
            200,
        ),
        (
            "answers that are not read",
            |address, from| {
                let file = "GET /vendor/uPlot.iife.min.js HTTP/1.1\r\nHost: HOST\r\n\r\n";
                ask_and_wait(address, from, 100, &file.repeat(100))
            },
            "GET /vendor/uPlot.iife.min.js".to_owned(),
            200,
        ),
        (
            "requests",
            |address, from| {
                let asks = "GET /api/v1/fleet HTTP/1.1\r\nHost: HOST\r\n\r\n";
                ask_and_wait(address, from, 20, &asks.repeat(200))
            },
            "GET /api/v1/fleet".to_owned(),
            200,
        ),
    ];
    let (ones, other) = (0..limits.len() as u8, Ipv4Addr::new(127, 0, 1, 1));
    for ((what, take, request, expected), one) in limits.into_iter().zip(ones) {
        let held = take(&address, Ipv4Addr::new(127, 0, 0, 10 + one));
        let head = request.replace("HOST", &address);
        let whole = match request.starts_with("GET") {
            true => format!("{head} HTTP/1.0\r\nHost: {address}\r\n\r\n"),
            false => head,
        };
        eventually(what, || {
            let mut stream = dial_from(other, &address);
            stream.write_all(whole.as_bytes()).unwrap();
            let mut answer = vec![0; 2_048];
            let length = stream.read(&mut answer).unwrap_or_else(|error| panic!("{what}: {error}"));
            let answer = String::from_utf8_lossy(&answer[..length]);
            let status: u16 = answer.get(9..12).unwrap_or_default().parse().unwrap();
            // A busy machine may have no frame of the worker in time. That is nobody's share.
            assert!([expected, 503].contains(&status), "{what}: {answer}");
            assert!(
                !["taken", "streams are"].iter().any(|word| answer.contains(word)),
                "{what}: {answer}"
            );
            status == expected
        });
        assert_eq!(get(&address, "/healthz").status, 200, "{what}");
        drop(held);
    }
}

#[test]
fn a_body_that_is_too_long_is_refused() {
    let fleet = Fleet::new();
    let (_server, address) = fleet.serve(&[]);
    let head = format!(
        "POST /api/v1/what_if HTTP/1.1\r\nHost: {address}\r\nContent-Type: application/json"
    );
    let body = vec![b' '; (1 << 20) + 1];
    let refused = send(&address, &head, &body);
    assert_eq!(refused.status, 413, "{}", refused.text());
}

#[test]
fn clients_that_ask_and_hang_up_leave_nothing_to_be_computed() {
    let fleet = Fleet::new();
    let _worker = fleet.worker();
    let _source = fleet.joulebus("publish sim --robots 20");
    let (_server, address) = fleet.serve(&[]);
    eventually("robots", || get_json(&address, "/api/v1/fleet")["totals"]["robots"] == 20);
    let head = format!(
        "POST /api/v1/what_if HTTP/1.1\r\nHost: {address}\r\nContent-Type: application/json"
    );
    let robots: Vec<u32> = (0..20).collect();
    let path = json!([{"x_m": 0, "y_m": 0}, {"x_m": 2_000, "y_m": 0, "speed_mps": 0.2}]);
    let long = json!({"rank": robots, "path": path, "return": "dock"}).to_string();
    let length = long.len();
    let request = format!("{head}\r\nContent-Length: {length}\r\n\r\n{long}");
    for _ in 0..13 {
        let asking: Vec<TcpStream> = (0..4)
            .map(|_| {
                let mut stream = dial(&address);
                stream.write_all(request.as_bytes()).unwrap();
                stream
            })
            .collect();
        // Time for the first of them to be computed. If it is not yet, the server has less to do.
        std::thread::sleep(Duration::from_millis(200));
        drop(asking);
    }
    let short = json!({"robot": 1, "idle_s": 20}).to_string();
    eventually("an answer", || {
        let answered = send(&address, &head, short.as_bytes());
        assert!([200, 503].contains(&answered.status), "{answered:?}");
        answered.status == 200
    });
    assert_live(&address);
}
