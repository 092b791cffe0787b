//! A real etcd server: the one of `JOULEBUS_ETCD`, or an installed one. Without one these tests log
//! that they skip, and with `CI=true` they fail.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::PathBuf;
use std::process::Command;

use joulebus_testkit::{Child, eventually};
use rustix::process::Signal;

/// A server with its own data, which survives its restarts.
pub(crate) struct Etcd {
    directory: tempfile::TempDir,
    host: String,
    port: u16,
    around: Box<dyn Fn(&Command) -> Command>,
    /// Folder with `fleet-ca.pem`, `etcd.pem` and `etcd.key`. The server then accepts only clients
    /// with a certificate of that authority.
    certificates: Option<PathBuf>,
    /// Number of this member, and the ports on which the members of its cluster reach each other.
    cluster: Option<(usize, Vec<u16>)>,
    server: Option<Child>,
}

impl Etcd {
    /// Starts a server on the address `host`. `around` turns a command into one of that host.
    pub(crate) fn start(
        host: &str,
        port: u16,
        around: impl Fn(&Command) -> Command + 'static,
    ) -> Option<Self> {
        Self::start_with(host, port, around, None)
    }

    /// Same as [`Etcd::start`], with certificates.
    pub(crate) fn start_with(
        host: &str,
        port: u16,
        around: impl Fn(&Command) -> Command + 'static,
        certificates: Option<PathBuf>,
    ) -> Option<Self> {
        let mut etcd = Self::new(host, port, around, certificates)?;
        etcd.again();
        Some(etcd)
    }

    /// Starts a cluster of three members on the address `host`, each with two free ports.
    pub(crate) fn cluster(
        host: &str,
        ports: [[u16; 2]; 3],
        around: impl Fn(&Command) -> Command + Clone + 'static,
    ) -> Option<Vec<Self>> {
        let peers: Vec<u16> = ports.iter().map(|[_, peer]| *peer).collect();
        let member = |(at, [client, _]): (usize, [u16; 2])| {
            let mut etcd = Self::new(host, client, around.clone(), None)?;
            etcd.cluster = Some((at, peers.clone()));
            etcd.spawn();
            Some(etcd)
        };
        let mut members =
            ports.into_iter().enumerate().map(member).collect::<Option<Vec<Self>>>()?;
        members.iter_mut().for_each(Self::is_ready);
        Some(members)
    }

    fn new(
        host: &str,
        port: u16,
        around: impl Fn(&Command) -> Command + 'static,
        certificates: Option<PathBuf>,
    ) -> Option<Self> {
        let named = std::env::var_os("JOULEBUS_ETCD").filter(|named| !named.is_empty());
        let program = named.unwrap_or_else(|| "etcd".into());
        let is_there = Command::new(&program).arg("--version").output();
        if !is_there.is_ok_and(|shown| shown.status.success()) {
            let why = "there is no etcd (JOULEBUS_ETCD=$(tools/etcd.sh))";
            assert!(std::env::var_os("CI").is_none_or(|ci| ci != "true"), "{why}");
            eprintln!("skipped: {why}");
            return None;
        }
        Some(Self {
            // In memory, because etcd renews no lease while a disk is busy.
            directory: tempfile::tempdir_in("/dev/shm").unwrap(),
            host: host.to_owned(),
            port,
            around: Box::new(around),
            certificates,
            cluster: None,
            server: None,
        })
    }

    pub(crate) fn pid(&self) -> u32 {
        self.server.as_ref().unwrap().pid()
    }

    pub(crate) fn endpoint(&self) -> String {
        let scheme = self.certificates.as_ref().map_or("http", |_| "https");
        format!("{scheme}://{}:{}", self.host, self.port)
    }

    /// Starts the server again, with its data.
    pub(crate) fn again(&mut self) {
        self.spawn();
        self.is_ready();
    }

    fn spawn(&mut self) {
        let named = std::env::var_os("JOULEBUS_ETCD").filter(|named| !named.is_empty());
        let endpoint = self.endpoint();
        let mut command = Command::new(named.unwrap_or_else(|| "etcd".into()));
        command.args(["--listen-client-urls", &endpoint]);
        command.args(["--advertise-client-urls", &endpoint]);
        if let Some((at, ports)) = &self.cluster {
            let address = |at: usize| format!("http://{}:{}", self.host, ports[at]);
            let all = (0..ports.len()).map(|at| format!("member-{at}={}", address(at)));
            command.args(["--name", &format!("member-{at}")]);
            command.args(["--listen-peer-urls", &address(*at)]);
            command.args(["--initial-advertise-peer-urls", &address(*at)]);
            command.args(["--initial-cluster", &all.collect::<Vec<_>>().join(",")]);
        } else {
            // A single member still needs a peer port. Let the system choose it.
            command.args(["--listen-peer-urls", "http://127.0.0.1:0"]);
        }
        command.arg("--data-dir").arg(self.directory.path());
        if let Some(folder) = &self.certificates {
            command.arg("--client-cert-auth");
            command.arg("--trusted-ca-file").arg(folder.join("fleet-ca.pem"));
            command.arg("--cert-file").arg(folder.join("etcd.pem"));
            command.arg("--key-file").arg(folder.join("etcd.key"));
        }
        self.server = Some(Child::spawn("etcd", (self.around)(&command)));
    }

    fn is_ready(&mut self) {
        self.server.as_mut().unwrap().wait_for_line("ready to serve client requests");
    }

    pub(crate) fn kill(&mut self) {
        if let Some(server) = &mut self.server {
            server.kill();
        }
    }

    pub(crate) fn pause(&mut self) {
        self.signal(Signal::STOP);
    }

    pub(crate) fn resume(&mut self) {
        self.signal(Signal::CONT);
    }

    fn signal(&mut self, signal: Signal) {
        if let Some(server) = &mut self.server {
            server.signal(signal);
        }
    }

    /// Posts to the server's gateway from this host.
    pub(crate) fn post(&self, verb: &str, body: &str) -> String {
        let mut answer = String::new();
        eventually("etcd answers", || {
            let Ok(mut stream) = TcpStream::connect((self.host.as_str(), self.port)) else {
                return false;
            };
            let length = body.len();
            let request = format!(
                "POST /v3/{verb} HTTP/1.0\r\nHost: etcd\r\nContent-Length: {length}\r\n\r\n{body}"
            );
            answer.clear();
            stream.write_all(request.as_bytes()).is_ok()
                && stream.read_to_string(&mut answer).is_ok()
                && answer.contains(" 200 ")
        });
        answer
    }
}
