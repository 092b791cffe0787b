//! Mutual TLS with certificates of the fleet's own authority. Needs `openssl`: without it these
//! tests log that they skip, and with `CI=true` they fail.

use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use joulebus_testkit::{Child, certificates, eventually};
use zenoh::Wait as _;

use crate::host::{FOLLOW, Host, SAMPLES, free_address, has_lost_edge, is_asked_by};

/// A link's file that uses the certificate of `of` in `folder`.
fn file(name: &str, of: &str, folder: &Path, network: &str, sides: &str) -> String {
    let tls = tls(folder, of);
    format!("name = \"{name}\"\n[network]\n{network}\n{tls}\n{sides}")
}

/// The TLS section of a link's file with the certificate of `of` in `folder`.
pub(crate) fn tls(folder: &Path, of: &str) -> String {
    let folder = folder.display();
    format!(
        "[network.tls]\nca = \"{folder}/fleet-ca.pem\"\ncertificate = \"{folder}/{of}.pem\"\n\
         key = \"{folder}/{of}.key\""
    )
}

fn frames(link: &mut Child) -> u64 {
    link.end().json()["taken"][0]["frames"].as_u64().unwrap()
}

#[test]
fn only_certificates_of_the_fleets_authority_are_let_in_and_samples_come_under_the_name_in_them() {
    let folder = tempfile::tempdir().unwrap();
    let (own, other) = (folder.path().join("own"), folder.path().join("other"));
    if !certificates(&own, 30, &["base", "edge", "desk"]) {
        return;
    }
    certificates(&other, 30, &["desk"]);
    // Expires before it is used.
    certificates(&own, 0, &["late"]);
    let address = free_address().replacen("tcp", "tls", 1);
    let base = Host::new();
    let _worker = base.worker();
    let listen = format!("listen = [\"{address}\"]");
    let connect = format!("connect = [\"{address}\"]");
    let takes = "[worker]\n[[worker.take]]\nfrom = \"edge\"\n";
    let mut link = base.link(&file("base", "base", &own, &listen, takes));
    // A planner gets frames only after a sample was accepted.
    let mut before = 0;
    // The robots' host, and then a planners' host that uses the robots' host's name.
    for (certificate, authority, is_let_in) in [
        ("edge", &own, true),
        ("desk", &own, false),
        ("desk", &other, false),
        ("late", &own, false),
    ] {
        let there = Host::new();
        let sides = format!("{SAMPLES}{FOLLOW}");
        let text = file("edge", certificate, authority, &connect, &sides);
        let mut edge = there.link(&text);
        if is_let_in {
            is_asked_by(&edge, "base");
        }
        let mut robots = there.robots(&["--robots", "2"]);
        let mut planner = is_let_in.then(|| there.planner());
        match &mut planner {
            Some(planner) => {
                for _ in 0..30 {
                    planner.fresh();
                }
            }
            None => std::thread::sleep(Duration::from_secs(3)),
        }
        robots.end();
        let report = edge.end().json();
        let given = report["given"][0]["frames"].as_u64().unwrap_or(0);
        assert_eq!(given > 0, is_let_in, "{certificate}: {report}");
        if is_let_in {
            // The last samples are still in flight: the worker takes them at its next tick.
            eventually("the end of the link is known", || has_lost_edge(&link));
        }
        let mut beside = base.planner();
        beside.fresh();
        beside.fresh();
        beside.leave();
        let now = accepted(&base);
        assert_eq!(now > before, is_let_in, "{certificate}: {report}");
        before = now;
    }
    assert!(frames(&mut link) > 10);
}

/// Waits until the link has logged this, and no library has in other words.
fn wait_for_log(link: &Child, expected: &str) {
    eventually(expected, || link.errors().contains(expected));
    assert!(!link.errors().contains("open file limit"), "{}", link.errors());
}

#[test]
fn both_links_report_why_a_certificate_is_refused() {
    const IP: &str = "127.0.0.1";
    let folder = tempfile::tempdir().unwrap();
    let (own, other) = (folder.path().join("own"), folder.path().join("other"));
    if !certificates(&own, 30, &["base", "edge"]) {
        return;
    }
    certificates(&other, 30, &["edge"]);
    certificates(&own, 0, &["late"]);
    // The certificate of the side that connects, the authority and the host that it expects, and
    // what it and the other side log.
    for ((of, name), authority, host, here, there) in [
        ((&other, "edge"), &own, IP, "refuses this link's certificate", "is of another authority"),
        ((&own, "edge"), &other, IP, "is of another authority", "in the other link's file"),
        ((&own, "edge"), &own, "localhost", "is for another address", "may be for another address"),
        ((&own, "late"), &own, IP, "it has expired", "certificate has expired"),
    ] {
        let address = free_address().replacen("tcp", "tls", 1);
        let (base, edge) = (Host::new(), Host::new());
        let _worker = base.worker();
        let listen = format!("listen = [\"{address}\"]");
        let takes = "[worker]\n[[worker.take]]\nfrom = \"edge\"\n";
        let mut link = base.link(&file("base", "base", &own, &listen, takes));
        let to = address.replace(IP, host);
        let text = file("edge", name, of, &format!("connect = [\"{to}\"]"), SAMPLES);
        let ca = |folder: &Path| format!("{}/fleet-ca.pem", folder.display());
        let mut edge = edge.link(&text.replace(&ca(of), &ca(authority)));
        wait_for_log(&edge, &format!("no connection to {to}: "));
        wait_for_log(&edge, here);
        wait_for_log(&link, there);
        edge.end();
        link.end();
    }
}

/// True if a stranger can connect, with this certificate and key or with none.
fn connects(address: &str, authority: &Path, certificate: Option<&str>) -> bool {
    let mut config = zenoh::Config::default();
    let mut set = |key: &str, value: String| config.insert_json5(key, &value).unwrap();
    set("mode", "\"client\"".to_owned());
    set("connect/endpoints", format!("[\"{address}\"]"));
    set("connect/timeout_ms", "3000".to_owned());
    set("connect/exit_on_failure", "true".to_owned());
    set("scouting/multicast/enabled", "false".to_owned());
    let file = |name: &str| format!("{:?}", authority.join(name).display().to_string());
    set("transport/link/tls/root_ca_certificate", file("fleet-ca.pem"));
    if let Some(name) = certificate {
        set("transport/link/tls/connect_certificate", file(&format!("{name}.pem")));
        set("transport/link/tls/connect_private_key", file(&format!("{name}.key")));
        set("transport/link/tls/enable_mtls", "true".to_owned());
    }
    zenoh::open(config).wait().is_ok_and(|session| {
        let mut peers = session.info().peers_zid().wait();
        let mut routers = session.info().routers_zid().wait();
        peers.next().is_some() || routers.next().is_some()
    })
}

/// The names of a process's threads.
fn threads(pid: u32) -> Vec<String> {
    let tasks = fs::read_dir(format!("/proc/{pid}/task")).unwrap();
    let names = tasks.filter_map(|task| fs::read_to_string(task.ok()?.path().join("comm")).ok());
    names.map(|name| name.trim().to_owned()).collect()
}

#[test]
fn who_shows_no_certificate_gets_no_connection() {
    let folder = tempfile::tempdir().unwrap();
    if !certificates(folder.path(), 30, &["base", "desk"]) {
        return;
    }
    let address = free_address().replacen("tcp", "tls", 1);
    let base = Host::new();
    let _worker = base.worker();
    let listen = format!("listen = [\"{address}\"]");
    let link = base.link(&file("base", "base", folder.path(), &listen, "[worker]\n"));
    // The connection attempt ends after three seconds.
    eventually("a connection", || connects(&address, folder.path(), Some("desk")));
    // A TLS connection breaks if one thread writes it while another reads it.
    let threads = threads(link.pid());
    let has = |name: &str| threads.iter().any(|thread| thread.starts_with(name));
    assert!(has("rx-") && !has("tx-"), "{threads:?}");
    assert!(!connects(&address, folder.path(), None));
}

/// Samples that the worker has accepted.
fn accepted(base: &Host) -> u64 {
    let mut accepted = None;
    eventually("the worker is connected", || {
        let watched = base.watched();
        accepted = watched.and_then(|watched| watched["samples_accepted"].as_u64());
        accepted.is_some()
    });
    accepted.unwrap()
}

#[test]
fn a_key_that_others_can_read_or_that_is_missing_is_refused_with_its_line() {
    let folder = tempfile::tempdir().unwrap();
    if !certificates(folder.path(), 30, &["base"]) {
        return;
    }
    let host = Host::new();
    let listen = "listen = [\"tls/127.0.0.1:7447\"]";
    let text = file("base", "base", folder.path(), listen, "[worker]\n");
    let key = folder.path().join("base.key");
    fs::set_permissions(&key, std::os::unix::fs::PermissionsExt::from_mode(0o644)).unwrap();
    let refused = Child::spawn("link", host.link_command(&text)).wait();
    assert_eq!(refused.code(), Some(2), "{refused:?}");
    assert!(refused.errors().contains("link.toml:7"), "{refused:?}");
    fs::remove_file(&key).unwrap();
    let refused = Child::spawn("link", host.link_command(&text)).wait();
    assert_eq!(refused.code(), Some(2), "{refused:?}");
}

#[test]
fn init_writes_files_and_certificates_that_check_compares() {
    let host = Host::new();
    let init = |words: &[&str]| {
        let mut command = host.program(&["init", "--out", "made", "base=127.0.0.1", "edge-1"]);
        Child::spawn("init", {
            command.args(words);
            command
        })
        .wait()
    };
    let check = |file: &str| {
        let mut command = host.program(&[file, "--check", "--config", "fleet.toml"]);
        Child::spawn("check", {
            command.args(["--format", "json"]);
            command
        })
        .wait()
    };
    let (base, edge) = ("made/base/link.toml", "made/edge-1/link.toml");
    let made = init(&["--port", "17447", "--days", "90"]);
    assert_eq!(made.code(), Some(0), "{made:?}");
    for (file, left, address) in
        [(base, "listen", "tls/0.0.0.0"), (edge, "connect", "tls/127.0.0.1")]
    {
        let report = check(file).json();
        let days_left = report["certificate"]["days_left"].as_i64();
        assert!((89..=90).contains(&days_left.unwrap()), "{report}");
        assert_eq!(report[left][0], format!("{address}:17447"), "{report}");
    }
    let key = |host: &Host, name: &str| host.read(&format!("made/{name}/{name}.key"));
    let before = key(&host, "edge-1");
    // Its file has another port, so the new host would connect elsewhere.
    let refused = init(&["edge-2"]);
    assert!(refused.code() == Some(2) && refused.errors().contains("--replace"), "{refused:?}");
    // What is there stays, so that it may have been copied and changed.
    let more = init(&["edge-2", "--port", "17447"]);
    assert!(more.text().contains("from = \"edge-2\""), "{more:?}");
    assert_eq!(key(&host, "edge-1"), before);
    assert_eq!(init(&["--replace", "--days", "1"]).code(), Some(0));
    assert_ne!(key(&host, "edge-1"), before);
    assert!(check(edge).json()["certificate"]["days_left"].as_i64() <= Some(1));
    // The key of another certificate, the name of another link, and another authority.
    let text = host.read(edge);
    for (change, refusal) in [
        (text.replace("edge-1.key", "../base/base.key"), "is not the key of"),
        (text.replace("\"edge-1\"", "\"edge-2\""), "is for the link \"edge-1\""),
        (text.replace("\"fleet-ca.pem\"", "\"../base/base.pem\""), "peers refuse"),
    ] {
        host.write(edge, &change);
        let refused = check(edge);
        assert_eq!(refused.code(), Some(2), "{change}");
        assert!(refused.errors().contains(refusal), "{refusal}: {refused:?}");
    }
    for wrong in [
        "base=10.0.0.9",
        "../x",
        "a/b",
        "x=tls/10.0.0.1:7447",
        "x=10.0.0.1:7447",
        "x=",
        "=10.0.0.1",
        "a b",
        "x=a b",
        "köln",
        "x=köln",
        "fleet-ca",
        "fleet-ca.pem",
        "x=[::1]",
    ] {
        assert_eq!(init(&[wrong]).code(), Some(2), "{wrong}");
    }
    assert_eq!(init(&["--port", "0"]).code(), Some(2));
    assert_eq!(init(&["x=::1", "y=10.0.0.2", "z=Z.example.org"]).code(), Some(0));
    // Its key may be kept elsewhere. Another authority would shut the old hosts out.
    fs::remove_file(host.config().with_file_name("made").join("fleet-ca.key")).unwrap();
    let before = host.read("made/fleet-ca.pem");
    let refused = init(&["edge-3"]);
    assert_eq!(refused.code(), Some(1), "{refused:?}");
    assert!(refused.errors().contains("fleet-ca.key is missing"), "{refused:?}");
    assert_eq!(host.read("made/fleet-ca.pem"), before);
}

/// Gives the link `name` a certificate of the authority in `folder` that expires after so many
/// seconds.
fn expires_after(folder: &Path, name: &str, seconds: u64) {
    let script = format!(
        "set -e; umask 077
         printf '%s\n' '[ca]' default_ca=c '[c]' database=index new_certs_dir=. rand_serial=yes \
             unique_subject=no default_md=sha256 policy=p '[p]' commonName=supplied \
             '[e]' subjectAltName=IP:127.0.0.1 extendedKeyUsage=serverAuth,clientAuth > soon.cnf
         touch index
         openssl req -new -key {name}.key -subj /CN={name} -out soon.csr
         openssl ca -batch -notext -config soon.cnf -extensions e -cert fleet-ca.pem \
             -keyfile fleet-ca.key -startdate 20200101000000Z \
             -enddate $(date -u -d '+{seconds} seconds' +%Y%m%d%H%M%SZ) -in soon.csr -out {name}.pem"
    );
    let made = Command::new("bash").args(["-c", &script]).current_dir(folder).output().unwrap();
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
}

#[test]
fn a_certificate_that_expires_ends_its_connection_and_a_renewed_one_makes_it_again() {
    let folder = tempfile::tempdir().unwrap();
    if !certificates(folder.path(), 30, &["base", "edge"]) {
        return;
    }
    let address = free_address().replacen("tcp", "tls", 1);
    let (base, there) = (Host::new(), Host::new());
    let _worker = base.worker();
    let listen = format!("listen = [\"{address}\"]");
    let takes = "[worker]\n[[worker.take]]\nfrom = \"edge\"\n";
    let mut link = base.link(&file("base", "base", folder.path(), &listen, takes));
    let connect = format!("connect = [\"{address}\"]");
    let text = file("edge", "edge", folder.path(), &connect, &format!("{SAMPLES}{FOLLOW}"));
    let mut valid_s = 20;
    expires_after(folder.path(), "edge", valid_s);
    let mut edge = there.link(&text);
    is_asked_by(&edge, "base");
    let _robots = there.robots(&["--robots", "2"]);
    let mut planner = there.planner();
    // On a busy machine a certificate may expire before anything comes. The next is valid for longer.
    while !planner.has_sample_within(Duration::from_secs(valid_s)) {
        valid_s *= 2;
        expires_after(folder.path(), "edge", valid_s);
    }
    // Both sides log it.
    eventually("the worker's side has lost the link", || has_lost_edge(&link));
    assert_eq!(planner.gone(), "Unreachable");
    // It is not let in again as long as the certificate has expired.
    assert!(planner.frame_within(Duration::from_secs(3)).is_none());
    assert!(edge.is_running() && link.is_running());
    wait_for_log(&link, "ends: the other link's certificate has expired");
    wait_for_log(&edge, "refuses this link's certificate: it has expired");
    assert!(certificates(folder.path(), 30, &["edge"]));
    planner.fresh_sample();
    edge.end();
    link.end();
}

/// A session with the certificate of `of`, which may send anything.
fn session(network: (&str, &str), folder: &Path, of: &str) -> zenoh::Session {
    let mut config = zenoh::Config::default();
    let mut set = |key: &str, value: String| config.insert_json5(key, &value).unwrap();
    set("mode", "\"peer\"".to_owned());
    set("scouting/multicast/enabled", "false".to_owned());
    set("listen/endpoints", "[]".to_owned());
    set(&format!("{}/endpoints", network.0), format!("[{:?}]", network.1));
    let file = |name: &str| format!("{:?}", folder.join(name).display().to_string());
    set("transport/link/tls/root_ca_certificate", file("fleet-ca.pem"));
    for side in ["connect", "listen"] {
        set(&format!("transport/link/tls/{side}_certificate"), file(&format!("{of}.pem")));
        set(&format!("transport/link/tls/{side}_private_key"), file(&format!("{of}.key")));
    }
    set("transport/link/tls/enable_mtls", "true".to_owned());
    zenoh::open(config).wait().unwrap()
}

/// Requests of a link for few frames, with their proofs: recorded by a session that has the
/// certificate of the link `base`.
fn requests(name: &str, folder: &Path) -> Vec<(Vec<u8>, Option<Vec<u8>>)> {
    let address = free_address().replacen("tcp", "tls", 1);
    let base = session(("listen", &address), folder, "base");
    let asked = base.declare_subscriber("joulebus/lab/ask/outputs/base/*").wait().unwrap();
    let host = Host::new();
    let network = format!("connect = [\"{address}\"]");
    let sides = format!("{FOLLOW}every = 3600\n");
    let _link = host.link(&file(name, name, folder, &network, &sides));
    let bytes = |bytes: &zenoh::bytes::ZBytes| bytes.to_bytes().into_owned();
    let request = || asked.recv().unwrap();
    let all = (0..9).map(|_| request()).map(|sample| {
        assert!(sample.key_expr().as_str().ends_with(&format!("/{name}")));
        (bytes(sample.payload()), sample.attachment().map(bytes))
    });
    all.collect()
}

/// `spy` has a certificate of the fleet too.
#[test]
fn no_certificate_requests_in_another_receivers_name_or_takes_more_than_its_own_place() {
    let folder = tempfile::tempdir().unwrap();
    if !certificates(folder.path(), 30, &["base", "desk", "spy"]) {
        return;
    }
    let requests = requests("spy", folder.path());
    let address = free_address().replacen("tcp", "tls", 1);
    let (base, there) = (Host::new(), Host::new());
    let _worker = base.worker();
    let listen = format!("listen = [\"{address}\"]");
    let mut link = base.link(&file("base", "base", folder.path(), &listen, "[worker]\n"));
    let _robots = base.robots(&["--robots", "2"]);
    let spy = session(("connect", &address), folder.path(), "spy");
    let sends = |name: &str, proven: bool| {
        for (request, proof) in &requests {
            let proof = proof.clone().filter(|_| proven);
            let key = format!("joulebus/lab/ask/outputs/base/{name}");
            spy.put(key, request.clone()).attachment(proof).wait().unwrap();
        }
    };
    // Its own requests are good, and not those of as many invented names as there are places.
    eventually("the spy is heard", || {
        sends("spy", true);
        link.errors().contains("link spy asks for ")
    });
    for at in 0..100 {
        sends(&format!("invented-{at}"), at % 2 == 0);
        std::thread::sleep(Duration::from_millis(5));
    }
    let connect = format!("connect = [\"{address}\"]");
    let mut desk = there.link(&file("desk", "desk", folder.path(), &connect, FOLLOW));
    let mut planner = there.planner();
    planner.fresh_sample();
    // Many requests in the name of another, for few frames. Of every 3600th tick there would be none.
    let (mut frames, mut at) = (0, 0);
    eventually("ten frames, whatever another requests", || {
        sends("desk", at % 2 == 0);
        at += 1;
        frames += u32::from(planner.frame_within(Duration::from_millis(20)).is_some());
        frames > 10
    });
    planner.fresh_sample();
    desk.end();
    let report = link.end().json();
    let given = report["given"].as_array().unwrap();
    let names: Vec<_> = given.iter().filter_map(|given| given["to"].as_str()).collect();
    assert_eq!(names, ["desk", "spy"], "{report}");
    let refused = report["refused"]["not the link in its certificate"].as_u64();
    assert!(refused > Some(100), "{report}");
}

/// A planners' host that listens, as a robots' host does that workers connect to.
#[test]
fn a_host_that_listens_takes_forecasts_of_its_worker_alone_while_that_is_silent() {
    let folder = tempfile::tempdir().unwrap();
    if !certificates(folder.path(), 30, &["base", "desk", "spy"]) {
        return;
    }
    let (base, there) = (Host::new(), Host::new());
    let addresses = [(); 2].map(|()| free_address().replacen("tcp", "tls", 1));
    let [of_desk, other] = &addresses;
    let listen = format!("listen = [\"{of_desk}\"]");
    let mut desk = there.link(&file("desk", "desk", folder.path(), &listen, FOLLOW));
    let mut worker = base.worker();
    let _robots = base.robots(&["--robots", "2"]);
    let connect = format!("listen = [\"{other}\"]\nconnect = [\"{of_desk}\"]");
    let mut link = base.link(&file("base", "base", folder.path(), &connect, "[worker]\n"));
    let mut planner = there.planner();
    planner.fresh_sample();
    // Real messages of the worker's link for `desk`, recorded by who has its certificate.
    let key = "joulebus/lab/outputs/base/desk";
    let recorder = session(("connect", other), folder.path(), "desk");
    let sent = recorder.declare_subscriber(key).wait().unwrap();
    let real: Vec<_> = (0..60).map(|_| sent.recv().unwrap().payload().clone()).collect();
    link.end();
    worker.end();
    drop(recorder);
    planner.gone();
    // Nothing comes from the worker's link for longer than a run is kept.
    std::thread::sleep(Duration::from_secs(2));
    let spy = session(("connect", of_desk), folder.path(), "spy");
    let right = session(("connect", of_desk), folder.path(), "base");
    let believed = || desk.errors().matches("the worker of base sends").count();
    for (session, is_believed) in [(&spy, false), (&right, true)] {
        let before = believed();
        for payload in real.iter().cycle().take(300) {
            session.put(key, payload.clone()).wait().unwrap();
            std::thread::sleep(Duration::from_millis(10));
        }
        assert_eq!(believed() > before, is_believed, "{}", desk.errors());
    }
    desk.end();
}
