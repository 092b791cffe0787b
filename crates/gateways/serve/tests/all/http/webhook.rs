//! Alarms posted to a web server of the test.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use joulebus_testkit::{Child, PATIENCE, eventually};
use rustix::net::sockopt::set_socket_linger;
use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::{ServerConfig, ServerConnection, StreamOwned};
use serde_json::Value;

use super::fleet::Fleet;

/// A request: its headers with names in lower case, and its body.
type Request = (Vec<(String, String)>, Vec<u8>);

/// A web server that answers its first requests with errors.
struct Receiver {
    address: String,
    taken: Arc<Mutex<Vec<Request>>>,
}

impl Receiver {
    /// Starts a receiver. `answers` are its first answers, empty for a closed connection,
    /// [`HALF_READ`], or [`RESET`] before one. Then it answers 204.
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
        let taken = Arc::<Mutex<Vec<Request>>>::default();
        let into = Arc::clone(&taken);
        std::thread::spawn(move || {
            let mut answers = answers.iter();
            for stream in listener.incoming() {
                let stream = stream.unwrap();
                let same = stream.try_clone().unwrap();
                let mut reader = BufReader::new(open(stream));
                let is_half = answers.as_slice().first() == Some(&HALF_READ);
                let Some(request) = request(&mut reader, if is_half { 2 } else { 1 }) else {
                    continue;
                };
                let answer = answers.next().unwrap_or(&"204 No Content");
                let (reset, answer) = match answer.strip_prefix(RESET) {
                    Some(answer) => (true, answer),
                    None => (false, *answer),
                };
                if reset {
                    // The client finds the connection reset, and not closed.
                    set_socket_linger(&same, Some(Duration::ZERO)).unwrap();
                }
                if answer.starts_with('2') {
                    into.lock().unwrap().push(request);
                }
                if !answer.is_empty() && answer != HALF_READ {
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

    /// The bodies of everything taken, in order.
    fn bodies(&self) -> Vec<Value> {
        let taken = self.taken.lock().unwrap();
        taken.iter().map(|(_, body)| serde_json::from_slice(body).unwrap()).collect()
    }

    /// Robot, alarm and change of everything taken, in order.
    fn changes(&self) -> Vec<String> {
        let bodies = self.bodies();
        let bodies = bodies.iter().inspect(|body| assert_eq!(body["fleet"], "http"));
        let changes = bodies.flat_map(|body| body["changes"].as_array().unwrap());
        let of = |change: &Value| {
            let meaning = change["card"]["meaning"].as_str();
            assert_eq!(meaning.is_some(), change["change"] == "raised", "{change}");
            format!("{} {} {}", change["robot"], change["alarm"], change["change"])
        };
        changes.map(of).map(|text| text.replace('"', "")).collect()
    }
}

/// A request, with one of so many parts of its body. `None` if none comes, for instance because the
/// client refuses a certificate.
fn request(reader: &mut impl BufRead, parts: usize) -> Option<Request> {
    let mut lines = Vec::new();
    loop {
        let mut line = String::new();
        if reader.read_line(&mut line).unwrap_or(0) == 0 || line == "\r\n" {
            break;
        }
        lines.push(line.trim_end().to_owned());
    }
    let first = lines.first()?;
    assert!(first.starts_with("POST /alarms?secret=1 "), "{lines:?}");
    let named = |line: &String| {
        let (name, value) = line.split_once(": ")?;
        Some((name.to_lowercase(), value.to_owned()))
    };
    let headers: Vec<_> = lines.iter().filter_map(named).collect();
    let length = headers.iter().find(|(name, _)| name == "content-length");
    let length: usize = length.map_or(0, |(_, length)| length.parse().unwrap());
    let mut body = vec![0; length / parts];
    reader.read_exact(&mut body).unwrap();
    Some((headers, body))
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

/// Starts a server with a file of receivers.
fn serve_listed(fleet: &Fleet, hooks: &str) -> Child {
    let file = fleet.file("hooks.toml");
    std::fs::write(&file, hooks).unwrap();
    serve_with(fleet, &["--webhooks", &file.display().to_string()])
}

/// Writes a file of mode 0600.
fn secret(fleet: &Fleet, name: &str, line: &str) -> PathBuf {
    let file = fleet.file(name);
    std::fs::write(&file, format!("{line}\n")).unwrap();
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o600)).unwrap();
    file
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
/// ticks that it missed are lost, too, and counted. Returns the report of each receiver.
fn end_delivered(server: &mut Child) -> Vec<Value> {
    let ended = server.end();
    let reports = ended.json()["webhooks"].as_array().unwrap().clone();
    let mut missed = 0;
    for report in &reports {
        missed = report["ticks_missed"].as_u64().unwrap();
        assert_eq!(report["lost"], missed, "{ended:?}");
    }
    let code = if missed > 0 { 3 } else { 0 };
    assert_eq!(ended.code(), Some(code), "{ended:?}");
    reports
}

fn publish(fleet: &Fleet) {
    fleet.joulebus("publish sim --robots 3 --duration 1").finish();
}

/// Closes the connection after one half of the body.
const HALF_READ: &str = "half";
/// Resets the connection after an answer, or before any.
const RESET: &str = "reset ";
/// Asks for a longer pause than the third attempt has by itself.
const BUSY: &str = "429 Too Many Requests\r\nretry-after: 6";

#[test]
fn a_receiver_that_closes_or_resets_is_sent_it_again_and_one_that_took_it_first_is_not() {
    for (answers, failed) in [
        (&[HALF_READ] as &[&str], 1),
        (&[""], 1),
        (&[RESET], 1),
        (&["reset 200 OK"], 0),
        (&["reset 503 Service Unavailable"], 1),
    ] {
        let fleet = Fleet::new();
        let receiver = Receiver::start(answers);
        let mut worker = fleet.worker();
        let mut server = serve(&fleet, &receiver.address);
        publish(&fleet);
        eventually("the robots' silence is told", || {
            (0..3).all(|robot| receiver.changes().contains(&format!("{robot} NoData raised")))
        });
        let report = end_delivered(&mut server);
        assert_eq!(report[0]["failed"], failed, "{answers:?}: {report:?}");
        assert_eq!(report[0]["told"], receiver.changes().len(), "{answers:?}: {report:?}");
        worker.stop();
    }
}

#[test]
fn every_change_is_sent_in_order_also_after_failures() {
    let fleet = Fleet::new();
    // A closed connection, an overloaded server, one that asks for a pause.
    let receiver = Receiver::start(&["", "503 Service Unavailable", BUSY]);
    let mut worker = fleet.worker();
    let mut watch = fleet.joulebus("alarms --format json");
    watch.wait_for_line("alarms of fleet");
    let file = secret(&fleet, "hook", &receiver.address);
    let mut server = serve(&fleet, &format!("@{}", file.display()));
    publish(&fleet);
    server.wait_for_line("pause_s=6");
    eventually("the robots' silence is told", || {
        (0..3).all(|robot| receiver.changes().contains(&format!("{robot} NoData raised")))
    });
    worker.kill();
    eventually("the worker's end is told", || {
        receiver.changes().iter().any(|change| change == "null WorkerGone raised")
    });
    let report = end_delivered(&mut server);
    assert_eq!(report[0]["told"], receiver.changes().len(), "{report:?}");
    assert_eq!(report[0]["failed"], 3, "{report:?}");
}

#[test]
fn what_is_refused_is_lost_and_counted() {
    let fleet = Fleet::new();
    let receiver = Receiver::start(&["400 Bad Request"]);
    let _worker = fleet.worker();
    let mut server = serve(&fleet, &receiver.address);
    publish(&fleet);
    server.wait_for_line("refused, and not sent again: 400");
    let ended = server.end();
    assert_eq!(ended.code(), Some(3), "{ended:?}");
    let report: Value = serde_json::from_str(&ended.text()).unwrap();
    assert!(report["webhooks"][0]["lost"].as_u64().unwrap() > 0, "{report}");
}

#[test]
fn a_receiver_with_tls_gets_it_if_its_certificate_is_of_the_named_authority_and_of_nobody_else() {
    let (Some(authority), Some(stranger)) = (Authority::new(), Authority::new()) else {
        return;
    };
    let fleet = Fleet::new();
    let receiver = Receiver::start_tls(&authority);
    let (own, other) = (authority.file(), stranger.file());
    let _worker = fleet.worker();
    let listed = |address: &str, authority: &str| {
        let hook = format!("[[webhook]]\naddress = \"{address}\"\nca = \"{authority}\"\n");
        serve_listed(&fleet, &hook)
    };
    // Another authority, and Mozilla's list.
    let mut refusing = [listed(&receiver.address, &other), serve(&fleet, &receiver.address)];
    publish(&fleet);
    for server in &mut refusing {
        server.wait_for_line("invalid peer certificate: ");
        let ended = server.end();
        assert_eq!(ended.code(), Some(3), "{ended:?}");
        let report: Value = serde_json::from_str(&ended.text()).unwrap();
        assert_eq!(report["webhooks"][0]["told"], 0, "{report}");
    }
    assert_eq!(receiver.changes(), Vec::<String>::new());
    // The right authority is not enough for a name that the certificate does not have.
    let name = receiver.address.replace("127.0.0.1", "localhost");
    let [mut refusing, mut server] = [&name, &receiver.address].map(|to| listed(to, &own));
    publish(&fleet);
    refusing.wait_for_line("invalid peer certificate: certificate not valid for name");
    assert_eq!(refusing.end().code(), Some(3));
    eventually("the robots' silence is told", || {
        (0..3).all(|robot| receiver.changes().contains(&format!("{robot} NoData raised")))
    });
    end_delivered(&mut server);
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
    let _worker = fleet.worker();
    let mut server = serve(&fleet, &to);
    publish(&fleet);
    let _first = requests.recv_timeout(PATIENCE).unwrap();
    let ended = server.end();
    assert_eq!(ended.code(), Some(3), "{ended:?}");
    let report: Value = serde_json::from_str(&ended.text()).unwrap();
    assert_eq!(report["webhooks"][0]["told"], 0, "{report}");
    assert!(report["webhooks"][0]["lost"].as_u64().unwrap() > 0, "{report}");
    // The request has 10 s. A server that waited for it would have sent it again.
    assert!(requests.try_recv().is_err(), "sent again");
}

const SECRET: &str = "whsec_MDEyMzQ1Njc4OTAxMjM0NTY3ODkwMTIzNDU2Nzg5MDE=";

#[test]
fn each_listed_receiver_gets_every_change_as_json_and_as_text_with_its_own_page_and_signature() {
    let fleet = Fleet::new();
    let [chat, signed] = [(); 2].map(|()| Receiver::start(&[]));
    let address = secret(&fleet, "chat", &chat.address);
    secret(&fleet, "secret", SECRET);
    let mut worker = fleet.worker();
    let mut server = serve_listed(
        &fleet,
        &format!(
            "[[webhook]]\naddress_file = {address:?}\npage = \"http://page/\"\n\
             [[webhook]]\naddress = {:?}\nsecret_file = \"secret\"\n",
            signed.address,
        ),
    );
    publish(&fleet);
    for (receiver, link) in [(&chat, " http://page/?robot=#"), (&signed, "")] {
        eventually("the robots' silence is told", || {
            let bodies = receiver.bodies();
            let texts: Vec<&str> =
                bodies.iter().map(|body| body["text"].as_str().unwrap()).collect();
            let mut lines = texts.iter().flat_map(|text| text.lines());
            (0..3).all(|robot| {
                let line = format!("fleet http, robot #: NoData raised (stale){link}");
                let line = line.replace('#', &robot.to_string());
                lines.any(|found| found == line)
                    && receiver.changes().contains(&format!("{robot} NoData raised"))
            })
        });
    }
    let reports = end_delivered(&mut server);
    assert_eq!(reports.len(), 2, "{reports:?}");
    for report in &reports {
        assert_eq!(report["told"], signed.changes().len(), "{reports:?}");
    }
    assert_eq!(chat.changes(), signed.changes());
    worker.stop();
    let is_of_signature = |(name, _): &(String, String)| name.starts_with("webhook-");
    assert!(!chat.taken.lock().unwrap()[0].0.iter().any(is_of_signature), "without a secret");
    let (headers, body) = signed.taken.lock().unwrap()[0].clone();
    is_verified(&headers, &body);
}

/// Has a request verified by the function of the documents, and by nothing that was changed.
fn is_verified(headers: &[(String, String)], body: &[u8]) {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../docs/how-to/webhook.md");
    let page = std::fs::read_to_string(page).unwrap();
    let (_, code) = page.split_once("```python\n").unwrap();
    let (code, _) = code.split_once("```").unwrap();
    let script = format!(
        "{code}\nimport json, sys\n\
         headers, body = json.loads(sys.argv[1]), sys.argv[2].encode()\n\
         assert is_signed(headers, body, {SECRET:?})\n\
         assert not is_signed(headers, body + b' ', {SECRET:?})\n\
         assert not is_signed(headers, body, {SECRET:?}[:-5] + 'AAAA=')\n\
         later = str(int(headers['webhook-timestamp']) + 1)\n\
         assert not is_signed(headers | {{'webhook-timestamp': later}}, body, {SECRET:?})\n"
    );
    let named = std::env::var("JOULEBUS_PYTHON").ok();
    let mut python = Command::new(named.as_deref().unwrap_or("python3"));
    let headers: serde_json::Map<String, Value> =
        headers.iter().map(|(name, value)| (name.clone(), value.as_str().into())).collect();
    python.arg("-c").arg(script).arg(Value::from(headers).to_string());
    match python.arg(std::str::from_utf8(body).unwrap()).output() {
        Ok(ended) => assert!(ended.status.success(), "{ended:?}"),
        Err(error) => {
            assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "no python3: {error}");
            eprintln!("SKIPPED: no python3: {error}");
        }
    }
}

#[test]
fn a_file_of_webhooks_that_is_refused_names_the_line() {
    let fleet = Fleet::new();
    let file = fleet.file("hooks.toml");
    std::fs::write(&file, "[[webhook]]\naddress = \"http://127.0.0.1:9/\"\nformat = \"slack\"\n")
        .unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_joulebus-serve"));
    command.arg("--webhooks").arg(&file).arg("--config").arg(fleet.path());
    let ended = Child::spawn("serve --webhooks", command).wait();
    assert_eq!(ended.code(), Some(2), "{ended:?}");
    let errors = ended.errors();
    assert!(errors.contains("hooks.toml:3") && errors.contains("--on-alarm"), "{ended:?}");
}
