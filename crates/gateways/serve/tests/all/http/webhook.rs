//! Alarms posted to a web server of the test.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::fs::PermissionsExt as _;
use std::process::Command;
use std::sync::{Arc, Mutex};

use joulebus_testkit::{Child, PATIENCE, eventually};
use rustix::process::Signal;
use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::{ServerConfig, ServerConnection, StreamOwned};
use serde_json::Value;

use super::fleet::Fleet;

/// A web server that answers its first requests with errors.
struct Receiver {
    address: String,
    taken: Arc<Mutex<Vec<Value>>>,
}

impl Receiver {
    /// Starts a receiver. `answers` are its first answers, empty for a closed connection. Then it
    /// answers 204.
    fn start(answers: &'static [&'static str]) -> Self {
        Self::with(answers, "http", |stream| stream)
    }

    /// Starts a receiver with TLS and a certificate for 127.0.0.1.
    fn start_tls(authority: &Authority) -> Self {
        let config = authority.server();
        Self::with(&[], "https", move |stream| {
            let connection = ServerConnection::new(Arc::clone(&config)).unwrap();
            StreamOwned::new(connection, stream)
        })
    }

    fn with<S: Read + Write>(
        answers: &'static [&'static str],
        scheme: &str,
        open: impl Fn(TcpStream) -> S + Send + 'static,
    ) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = format!("{scheme}://{}/alarms?secret=1", listener.local_addr().unwrap());
        let taken = Arc::<Mutex<Vec<Value>>>::default();
        let into = Arc::clone(&taken);
        std::thread::spawn(move || {
            let mut answers = answers.iter();
            for stream in listener.incoming() {
                let mut reader = BufReader::new(open(stream.unwrap()));
                let Some(body) = request(&mut reader) else {
                    continue;
                };
                let answer = answers.next().unwrap_or(&"204 No Content");
                if answer.starts_with('2') {
                    into.lock().unwrap().push(body);
                }
                if !answer.is_empty() {
                    let text = format!(
                        "HTTP/1.1 {answer}\r\ncontent-length: 0\r\nconnection: close\r\n\r\n"
                    );
                    let _ = reader.get_mut().write_all(text.as_bytes());
                    let _ = reader.get_mut().flush();
                }
            }
        });
        Self { address, taken }
    }

    /// Robot, alarm and change of everything taken, in order.
    fn changes(&self) -> Vec<String> {
        let taken = self.taken.lock().unwrap();
        let bodies = taken.iter().inspect(|body| assert_eq!(body["fleet"], "http"));
        let changes = bodies.flat_map(|body| body["changes"].as_array().unwrap());
        let of = |change: &Value| {
            let meaning = change["card"]["meaning"].as_str();
            assert_eq!(meaning.is_some(), change["change"] == "raised", "{change}");
            format!("{} {} {}", change["robot"], change["alarm"], change["change"])
        };
        changes.map(of).map(|text| text.replace('"', "")).collect()
    }
}

/// The body of a request. `None` if no request comes, for instance because the client refuses a
/// certificate.
fn request(reader: &mut impl BufRead) -> Option<Value> {
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
    let first = head.first()?;
    assert!(first.starts_with("POST /alarms?secret=1 "), "{head:?}");
    let mut body = vec![0; length];
    reader.read_exact(&mut body).unwrap();
    Some(serde_json::from_slice(&body).unwrap())
}

/// An authority of the test's own: files that openssl makes.
struct Authority {
    folder: tempfile::TempDir,
}

impl Authority {
    /// Makes an authority. `None` without openssl, which is logged.
    fn new() -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let authority = Self { folder };
        let made = authority.make("authority", &["-addext", "basicConstraints=critical,CA:TRUE"]);
        if made.is_ok() {
            return Some(authority);
        }
        let why = "openssl is not installed";
        assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "{why}");
        eprintln!("SKIPPED: {why}");
        None
    }

    /// Makes a key and a certificate.
    fn make(&self, name: &str, more: &[&str]) -> std::io::Result<()> {
        let mut openssl = Command::new("openssl");
        openssl.current_dir(self.folder.path());
        openssl.args("req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1".split(' '));
        openssl.args(["-nodes", "-days", "2", "-subj"]);
        openssl.arg(format!("/CN={name} of a test"));
        openssl.args(["-keyout", &format!("{name}.key"), "-out", &format!("{name}.pem")]);
        let ended = openssl.args(more).output()?;
        assert!(ended.status.success(), "{ended:?}");
        Ok(())
    }

    /// Its certificate.
    fn file(&self) -> String {
        let path = self.folder.path().join("authority.pem");
        path.display().to_string()
    }

    /// A server with a certificate of this authority for 127.0.0.1.
    fn server(&self) -> Arc<ServerConfig> {
        let more = [
            "-CA",
            "authority.pem",
            "-CAkey",
            "authority.key",
            "-addext",
            "basicConstraints=critical,CA:FALSE",
            "-addext",
            "subjectAltName=IP:127.0.0.1",
        ];
        self.make("server", &more).unwrap();
        let file = |name: &str| self.folder.path().join(name);
        let certificate = CertificateDer::from_pem_file(file("server.pem")).unwrap();
        let key = PrivateKeyDer::from_pem_file(file("server.key")).unwrap();
        let config =
            ServerConfig::builder().with_no_client_auth().with_single_cert(vec![certificate], key);
        Arc::new(config.unwrap())
    }
}

fn serve(fleet: &Fleet, to: &str) -> Child {
    serve_with(fleet, &["--webhook", to])
}

fn serve_with(fleet: &Fleet, words: &[&str]) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_joulebus-serve"));
    command.args(words).args(["--format", "json", "--config"]);
    command.arg(fleet.path()).env_remove("JOULEBUS_LOG");
    let mut server = Child::spawn("serve --webhook", command);
    server.wait_for_line("of alarms of fleet");
    server
}

/// Ends a server that has delivered every change. It reads diagnostics as it gets a processor:
/// ticks that it missed are lost, too, and counted.
fn end_delivered(server: &mut Child) -> Value {
    let ended = server.end();
    let report = ended.json();
    let missed = report["webhook"]["ticks_missed"].as_u64().unwrap();
    assert_eq!(report["webhook"]["lost"], missed, "{ended:?}");
    let code = if missed > 0 { 3 } else { 0 };
    assert_eq!(ended.code(), Some(code), "{ended:?}");
    report
}

fn publish(fleet: &Fleet) {
    fleet.joulebus("publish sim --robots 3 --duration 1").finish();
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
        (0..3).all(|robot| receiver.changes().contains(&format!("{robot} NoData raised")))
    });
    worker.signal(Signal::KILL);
    eventually("the worker's end is told", || {
        receiver.changes().iter().any(|change| change == "null WorkerGone raised")
    });
    let report = end_delivered(&mut server);
    assert_eq!(report["webhook"]["told"], receiver.changes().len(), "{report}");
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

#[test]
fn a_receiver_with_tls_is_told_if_its_certificate_is_of_the_named_authority_and_by_nobody_else() {
    let (Some(authority), Some(stranger)) = (Authority::new(), Authority::new()) else {
        return;
    };
    let fleet = Fleet::new();
    let receiver = Receiver::start_tls(&authority);
    let (own, other) = (authority.file(), stranger.file());
    let mut worker = fleet.worker();
    // Another authority, and Mozilla's list.
    let mut refusing = [
        serve_with(&fleet, &["--webhook", &receiver.address, "--webhook-ca", &other]),
        serve(&fleet, &receiver.address),
    ];
    publish(&fleet);
    for server in &mut refusing {
        server.wait_for_line("invalid peer certificate: ");
        let ended = server.end();
        assert_eq!(ended.code(), Some(3), "{ended:?}");
        let report: Value = serde_json::from_str(&ended.text()).unwrap();
        assert_eq!(report["webhook"]["told"], 0, "{report}");
    }
    assert_eq!(receiver.changes(), Vec::<String>::new());
    // The right authority is not enough for a name that the certificate does not have.
    let name = receiver.address.replace("127.0.0.1", "localhost");
    let words = ["--webhook", &name, "--webhook-ca", &own];
    let [mut refusing, mut server] =
        [&words, &["--webhook", &receiver.address, "--webhook-ca", &own]]
            .map(|words| serve_with(&fleet, words));
    publish(&fleet);
    refusing.wait_for_line("invalid peer certificate: certificate not valid for name");
    assert_eq!(refusing.end().code(), Some(3));
    eventually("the robots' silence is told", || {
        (0..3).all(|robot| receiver.changes().contains(&format!("{robot} NoData raised")))
    });
    end_delivered(&mut server);
    worker.stop();
}

#[test]
fn a_file_without_certificates_is_refused() {
    let fleet = Fleet::new();
    let file = fleet.file("empty.pem");
    std::fs::write(&file, "no certificate\n").unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_joulebus-serve"));
    command.args(["--webhook", "https://127.0.0.1:9/", "--webhook-ca"]);
    command.arg(&file).arg("--config").arg(fleet.path());
    let ended = Child::spawn("serve --webhook", command).wait();
    assert_eq!(ended.code(), Some(2), "{ended:?}");
    assert!(ended.errors().contains("no certificate is in it"), "{ended:?}");
}

#[test]
fn a_receiver_that_never_answers_does_not_hold_up_the_end() {
    let fleet = Fleet::new();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let to = format!("http://{}/x", listener.local_addr().unwrap());
    let (accepted, requests) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            // The test may have ended.
            let _ = accepted.send(stream);
        }
    });
    let mut worker = fleet.worker();
    let mut server = serve(&fleet, &to);
    publish(&fleet);
    let _first = requests.recv_timeout(PATIENCE).unwrap();
    let ended = server.end();
    assert_eq!(ended.code(), Some(3), "{ended:?}");
    let report: Value = serde_json::from_str(&ended.text()).unwrap();
    assert_eq!(report["webhook"]["told"], 0, "{report}");
    assert!(report["webhook"]["lost"].as_u64().unwrap() > 0, "{report}");
    // The request has 10 s. A server that waited for it would have sent it again.
    assert!(requests.try_recv().is_err(), "sent again");
    worker.stop();
}
