//! Brokers with TLS. Needs `openssl`: without it these tests log that they skip, and with `CI=true`
//! they fail.

use std::path::Path;
use std::thread;
use std::time::Duration;

use joulebus_testkit::{Child, certificates, free_port};

use super::broker::{Broker, mosquitto};
use super::{Robots, file, is_forecast};
use crate::fleet::Fleet;

/// The lines of a second port of a broker, with TLS and the certificate of `of`.
fn port(port: u16, folder: &Path, of: &str, needs_certificate: bool) -> String {
    let folder = folder.display();
    format!(
        "listener {port} 127.0.0.1\ncafile {folder}/fleet-ca.pem\ncertfile {folder}/{of}.pem\n\
         keyfile {folder}/{of}.key\nrequire_certificate {needs_certificate}\n"
    )
}

/// Authority, and the bridge's certificate, of a bridge's file.
fn tls(authority: &Path, identity: Option<&Path>) -> String {
    let ca = authority.join("fleet-ca.pem");
    let mut text = format!("[mqtt.tls]\nca = \"{}\"\n", ca.display());
    if let Some(folder) = identity {
        let folder = folder.display();
        text += &format!("certificate = \"{folder}/bridge.pem\"\nkey = \"{folder}/bridge.key\"\n");
    }
    text
}

#[test]
fn only_brokers_of_the_named_authority_are_trusted_and_they_ask_for_a_certificate_of_it() {
    let folder = tempfile::tempdir().unwrap();
    let (own, other) = (folder.path().join("own"), folder.path().join("other"));
    let Some(program) = mosquitto() else { return };
    if !certificates(&own, 30, &["broker", "bridge"]) || !certificates(&other, 30, &["bridge"]) {
        return;
    }
    assert!(certificates(&own, 0, &["late"]));
    let (open, asking, late) = (free_port(), free_port(), free_port());
    let more = [
        "allow_anonymous true".to_owned(),
        port(open, &own, "broker", false),
        port(asking, &own, "broker", true),
        port(late, &own, "late", false),
    ];
    let (fleet, broker) = (Fleet::new(), Broker::start(&program, &more.join("\n")));
    let plain: u16 = broker.address().rsplit_once(':').unwrap().1.parse().unwrap();
    let at = |address: &str, tls: &str| {
        let text = file(&broker).replace(&broker.address(), address);
        text.replacen("[[mqtt.read]]", &format!("{tls}[[mqtt.read]]"), 1)
    };
    let local = |port: u16| format!("127.0.0.1:{port}");
    let mut worker = fleet.worker();
    for version in ["version = \"5\"", "version = \"3.1.1\""] {
        let text = at(&local(asking), &tls(&own, Some(&own)));
        let text = text.replace("[mqtt]", &format!("[mqtt]\n{version}"));
        let mut bridge = fleet.bridge(&text, "connected to ");
        let listener = broker.client("listener", "jb/#");
        let robots = Robots::start(broker.client("robots", "nothing").client);
        listener.wait_for("jb/lab/r3/forecast", is_forecast);
        drop(robots);
        bridge.kill();
        listener.wait_for("jb/lab/bridge", |status| status["state"] == "offline");
    }
    // A certificate ends with a second.
    thread::sleep(Duration::from_secs(2));
    for (address, tls, cause, remedy) in [
        (local(open), tls(&other, None), "BadSignature", "mqtt.tls.ca"),
        (local(late), tls(&own, None), "expired", "Renew"),
        (format!("localhost:{open}"), tls(&own, None), "not valid for name", "mqtt.broker"),
        (local(asking), tls(&own, None), "alert", "mqtt.tls.certificate"),
        (local(asking), tls(&own, Some(&other)), "alert", "mqtt.tls.certificate"),
    ] {
        let ended = Child::spawn("bridge", fleet.command(&at(&address, &tls))).wait();
        assert_eq!(ended.exit_code(), 1, "{cause}: {ended:?}");
        joulebus_testkit::assert_contains(&ended.errors(), [cause, remedy]);
    }
    // TLS to a port without it gets no answer, nor does plain text to a port with it.
    for (port, tls) in [(plain, tls(&own, None)), (open, String::new())] {
        let mut bridge = Child::spawn("bridge", fleet.command(&at(&local(port), &tls)));
        bridge.wait_for_line("A port of TLS needs [mqtt.tls]");
        bridge.kill();
    }
    worker.stop();
}

#[test]
fn renewed_certificates_are_used_without_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let (used, newer) = (folder.path().join("used"), folder.path().join("newer"));
    let Some(program) = mosquitto() else { return };
    if !certificates(&used, 30, &["broker", "bridge"]) {
        return;
    }
    assert!(certificates(&newer, 30, &["broker", "bridge"]));
    let secure = free_port();
    let more = port(secure, &used, "broker", true);
    let (fleet, mut broker) =
        (Fleet::new(), Broker::start(&program, &format!("allow_anonymous true\n{more}")));
    let text = format!(
        "[robots]\nr = 1\n[mqtt]\nbroker = \"127.0.0.1:{secure}\"\n\
         vda5050 = [{{ topic = \"a/{{robot}}\" }}]\n{}",
        tls(&used, Some(&used))
    );
    let mut bridge = fleet.bridge(&text, "connected to ");
    broker.kill();
    bridge.wait_for_line("not connected to ");
    // Signed by another authority.
    std::fs::rename(&used, folder.path().join("older")).unwrap();
    std::fs::rename(&newer, &used).unwrap();
    broker.restart();
    loop {
        let line = bridge.wait_for_line("connected to ");
        if line.starts_with("connected to ") {
            break;
        }
    }
    bridge.stop();
}
