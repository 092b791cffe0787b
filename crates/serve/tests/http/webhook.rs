//! Alarms told to a web address: a server of the test takes them.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpListener;
use std::os::unix::fs::PermissionsExt as _;
use std::process::Command;
use std::sync::{Arc, Mutex};

use joulebus_test_processes::{Child, eventually};
use rustix::process::Signal;
use serde_json::Value;

use crate::fleet::Fleet;

/// A web server that answers its first requests with errors.
struct Receiver {
    address: String,
    taken: Arc<Mutex<Vec<Value>>>,
}

impl Receiver {
    /// `answers`: the first answers, empty for a closed connection; then 204.
    fn start(answers: &'static [&'static str]) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = format!("http://{}/alarms?secret=1", listener.local_addr().unwrap());
        let taken = Arc::<Mutex<Vec<Value>>>::default();
        let into = Arc::clone(&taken);
        std::thread::spawn(move || {
            let mut answers = answers.iter();
            for stream in listener.incoming() {
                let mut reader = BufReader::new(stream.unwrap());
                let (mut head, mut length) = (Vec::new(), 0);
                loop {
                    let mut line = String::new();
                    if reader.read_line(&mut line).unwrap_or(0) == 0 || line == "\r\n" {
                        break;
                    }
                    let (name, value) = line.split_once(": ").unwrap_or((&line, ""));
                    if name.eq_ignore_ascii_case("content-length") {
                        length = value.trim().parse().unwrap();
                    }
                    head.push(line);
                }
                let mut body = vec![0; length];
                reader.read_exact(&mut body).unwrap();
                assert!(head[0].starts_with("POST /alarms?secret=1 "), "{head:?}");
                let answer = answers.next().unwrap_or(&"204 No Content");
                if answer.starts_with('2') {
                    into.lock()
                        .unwrap()
                        .push(serde_json::from_slice(&body).unwrap());
                }
                if !answer.is_empty() {
                    let text = format!(
                        "HTTP/1.1 {answer}\r\ncontent-length: 0\r\nconnection: close\r\n\r\n"
                    );
                    let _ = reader.get_mut().write_all(text.as_bytes());
                }
            }
        });
        Self { address, taken }
    }

    /// Robot, alarm and change of everything taken, in order.
    fn changes(&self) -> Vec<String> {
        let taken = self.taken.lock().unwrap();
        let bodies = taken
            .iter()
            .inspect(|body| assert_eq!(body["fleet"], "http"));
        let changes = bodies.flat_map(|body| body["changes"].as_array().unwrap());
        let of = |change: &Value| {
            format!(
                "{} {} {}",
                change["robot"], change["alarm"], change["change"]
            )
        };
        changes.map(of).map(|text| text.replace('"', "")).collect()
    }
}

fn serve(fleet: &Fleet, to: &str) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_joulebus-serve"));
    command.args(["--webhook", to, "--format", "json", "--config"]);
    command.arg(fleet.path()).env_remove("JOULEBUS_LOG");
    let mut server = Child::spawn("serve --webhook", command);
    server.wait_for_line("telling 127.0.0.1 of alarms");
    server
}

fn publish(fleet: &Fleet) {
    fleet
        .joulebus("publish sim --robots 3 --duration 1")
        .finish();
}

#[test]
fn every_change_is_told_in_order_also_after_failures() {
    let fleet = Fleet::new();
    // A closed connection, an overloaded server, one that asks for a pause.
    let receiver = Receiver::start(&["", "503 Service Unavailable", "429 Too Many Requests"]);
    let mut worker = fleet.worker();
    let mut watch = fleet.joulebus("alarms --format json");
    watch.wait_for_line("alarms of fleet");
    let file = fleet.file("hook");
    std::fs::write(&file, format!("{}\n", receiver.address)).unwrap();
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o600)).unwrap();
    let mut server = serve(&fleet, &format!("@{}", file.display()));
    publish(&fleet);
    eventually("the robots' silence is told", || {
        (0..3).all(|robot| {
            receiver
                .changes()
                .contains(&format!("{robot} NoData raised"))
        })
    });
    worker.signal(Signal::KILL);
    eventually("the worker's end is told", || {
        receiver
            .changes()
            .iter()
            .any(|change| change == "null WorkerGone raised")
    });
    let ended = server.end();
    assert_eq!(ended.code(), Some(0), "{ended:?}");
    let report: Value = serde_json::from_str(&ended.text()).unwrap();
    assert_eq!(
        report["webhook"]["told"],
        receiver.changes().len(),
        "{report}"
    );
    assert_eq!(report["webhook"]["failed"], 3, "{report}");
    watch.end();
    drop(worker);
}

#[test]
fn what_is_refused_is_lost_and_counted() {
    let fleet = Fleet::new();
    let receiver = Receiver::start(&["400 Bad Request"]);
    let mut worker = fleet.worker();
    let mut server = serve(&fleet, &receiver.address);
    publish(&fleet);
    server.wait_for_line("refused, and not sent again: 400");
    let ended = server.end();
    assert_eq!(ended.code(), Some(3), "{ended:?}");
    let report: Value = serde_json::from_str(&ended.text()).unwrap();
    assert!(report["webhook"]["lost"].as_u64().unwrap() > 0, "{report}");
    worker.stop();
}
