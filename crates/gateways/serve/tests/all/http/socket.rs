//! A Unix socket whose group may ask about plans, but can neither read shared memory nor publish.

use std::fs;
use std::io::{self, Read as _, Write as _};
use std::os::unix::fs::{PermissionsExt as _, chown};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};

use joulebus_publisher::Publisher;
use joulebus_testkit::{PATIENCE, eventually};
use rustix::process::{Gid, Uid, geteuid};
use rustix::thread::{set_thread_groups, set_thread_res_gid, set_thread_res_uid};
use serde_json::Value;

use super::fleet::Fleet;

/// A group without other members, and two users other than this one.
const READERS: u32 = 61_177;
const OF_THE_GROUP: u32 = 61_178;
const OTHER: u32 = 61_179;

/// Status and body of a request.
fn ask(socket: &Path, head: &str, body: &str) -> io::Result<(u16, String)> {
    let mut stream = UnixStream::connect(socket)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    let length = body.len();
    let request = format!("{head}\r\nConnection: close\r\nContent-Length: {length}\r\n\r\n{body}");
    stream.write_all(request.as_bytes())?;
    let mut text = String::new();
    stream.read_to_string(&mut text)?;
    let status = text.split(' ').nth(1).and_then(|status| status.parse().ok());
    let (_, body) = text.split_once("\r\n\r\n").unwrap_or_default();
    Ok((status.unwrap_or(0), body.to_owned()))
}

fn get(socket: &Path, path: &str) -> io::Result<(u16, String)> {
    ask(socket, &format!("GET {path} HTTP/1.1\r\nHost: localhost"), "")
}

/// Does `work` as another user: credentials are a thread's own, and end with it.
fn as_user<T: Send>(user: u32, group: u32, work: impl FnOnce() -> T + Send) -> T {
    std::thread::scope(|scope| {
        let thread = scope.spawn(|| {
            let (user, group) = (Uid::from_raw(user), Gid::from_raw(group));
            set_thread_groups(&[]).unwrap();
            set_thread_res_gid(group, group, group).unwrap();
            set_thread_res_uid(user, user, user).unwrap();
            assert!(fs::read_dir("/root").is_err() && !geteuid().is_root());
            work()
        });
        thread.join().unwrap()
    })
}

/// True if this process can become another user. If not, that is logged.
fn can_become_another() -> bool {
    if geteuid().is_root() {
        return true;
    }
    let why = "only root can become another user";
    assert!(std::env::var("CI").as_deref() != Ok("true"), "{why}");
    eprintln!("SKIPPED: {why}");
    false
}

/// Everything that the fleet has in shared memory.
fn objects(fleet: &Fleet) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = Vec::new();
    for path in fleet.stale_files() {
        if path.is_dir() {
            folders.push(path);
        } else {
            found.push(path);
        }
    }
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap().flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else {
                found.push(path);
            }
        }
        found.push(folder);
    }
    found
}

#[test]
fn a_group_that_may_read_can_plan_and_neither_publish_nor_open_shared_memory() {
    if !can_become_another() {
        return;
    }
    let fleet = Fleet::new();
    let _worker = fleet.worker();
    let mut source = fleet.joulebus("publish sim --robots 4");
    // Same as systemd's RuntimeDirectory= of mode 0750: files in it get its group.
    let place = tempfile::tempdir().unwrap();
    fs::set_permissions(place.path(), fs::Permissions::from_mode(0o755)).unwrap();
    let folder = place.path().join("run");
    fs::create_dir(&folder).unwrap();
    chown(&folder, None, Some(READERS)).unwrap();
    fs::set_permissions(&folder, fs::Permissions::from_mode(0o2750)).unwrap();
    let socket = folder.join("http.sock");
    let shown = socket.display().to_string();
    let (mut server, _) = fleet.serve(&["--socket", &shown]);
    eventually("robots", || {
        let (_, body) = get(&socket, "/api/v1/fleet").unwrap();
        let fleet: Value = serde_json::from_str(&body).unwrap();
        fleet["totals"]["robots"] == 4
    });

    // A config that the group may read.
    let config = place.path().join("fleet.toml");
    fs::copy(fleet.path(), &config).unwrap();
    fs::set_permissions(&config, fs::Permissions::from_mode(0o644)).unwrap();
    let objects = objects(&fleet);
    assert!(objects.len() > 10, "{objects:?}");
    as_user(OF_THE_GROUP, READERS, || {
        let (status, body) = get(&socket, "/api/v1/robots/2").unwrap();
        assert_eq!(status, 200, "{body}");
        let head =
            "POST /api/v1/what_if HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json";
        let question = r#"{"robot": 2, "idle_s": 10}"#;
        eventually("an answer about a plan", || {
            let (status, body) = ask(&socket, head, question).unwrap();
            assert!([200, 503].contains(&status), "{status}: {body}");
            status == 200
        });
        // The server writes no samples, and shared memory is closed to the group.
        let (status, _) = get(&socket, "/api/v1/samples").unwrap();
        assert_eq!(status, 404);
        let refused = Publisher::connect(&config, "group").map(drop);
        let refused = refused.expect_err("published").to_string();
        assert!(refused.contains("belongs to uid"), "{refused}");
        for object in &objects {
            let options =
                [fs::File::options().read(true).clone(), fs::File::options().write(true).clone()];
            for options in options {
                let opened = options.open(object);
                assert!(opened.is_err(), "opened {}", object.display());
            }
            assert!(fs::read_dir(object).is_err(), "read {}", object.display());
        }
    });
    as_user(OTHER, OTHER, || {
        let refused = get(&socket, "/api/v1/fleet").unwrap_err();
        assert_eq!(refused.kind(), io::ErrorKind::PermissionDenied);
    });
    // The folder alone, without the group of the socket, is not enough.
    fs::set_permissions(&folder, fs::Permissions::from_mode(0o755)).unwrap();
    as_user(OTHER, OTHER, || {
        let refused = get(&socket, "/api/v1/fleet").unwrap_err();
        assert_eq!(refused.kind(), io::ErrorKind::PermissionDenied);
    });
    source.end();
    server.stop();
    assert!(!socket.exists(), "the socket is left");
}

#[test]
fn a_socket_is_served_alone_and_refuses_pages_of_other_sites() {
    let fleet = Fleet::new();
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("http.sock");
    let mut server = fleet.serve_at(&socket);
    assert_eq!(get(&socket, "/healthz").unwrap().0, 200);
    let (status, body) = get(&socket, "/").unwrap();
    assert!(status == 200 && body.contains("<html"), "{status}: {body}");
    let other_host = "GET /api/v1/fleet HTTP/1.1\r\nHost: evil.example";
    assert_eq!(ask(&socket, other_host, "").unwrap().0, 403);
    let other_site = "GET /api/v1/fleet HTTP/1.1\r\nHost: localhost\r\nSec-Fetch-Site: cross-site";
    assert_eq!(ask(&socket, other_site, "").unwrap().0, 403);
    let mut second = fleet.serve_at_any(&socket);
    let ended = second.wait();
    assert_eq!(ended.code(), Some(1), "{ended:?}");
    assert!(ended.errors().contains("another server does"), "{ended:?}");
    // Killed, it leaves its file, which the next one replaces.
    server.kill();
    assert!(socket.exists());
    let mut server = fleet.serve_at(&socket);
    assert_eq!(get(&socket, "/healthz").unwrap().0, 200);
    server.stop();
    assert!(!socket.exists());
}
