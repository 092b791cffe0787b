//! The page's server from a client's point of view, with real processes.

mod client;
pub(crate) mod fleet;
mod hostile;
mod metrics;
mod openapi;
mod socket;
mod webhook;

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::PathBuf;
use std::process::Command;

use client::{Events, acknowledge, get, get_json, post, send, what_if};
use fleet::Fleet;
use joulebus_connect::findings::FindingsFile;
use joulebus_testkit::{
    MemoryGroup, PATIENCE, as_in_docker, assert_contains, end_signals, eventually, remove,
};
use joulebus_wire::fnv1a;
use rustix::process::Signal;
use serde_json::{Value, json};

#[test]
fn a_stopped_workers_values_equal_those_of_watch() {
    let fleet = Fleet::new();
    let mut worker = fleet.worker();
    let _source = fleet.joulebus("publish sim --robots 6 --fault 3=stuck");
    let (_server, address) = fleet.serve(&[]);
    let watch = fleet.joulebus("watch --format json");
    eventually("six robots", || get_json(&address, "/api/v1/fleet")["totals"]["robots"] == 6);
    // A worker stopped between two frames of a tick may appear to one program and not to the other.
    // Try again then.
    let mut lines = 0;
    eventually("the same tick with the same values", || {
        worker.signal(Signal::CONT);
        assert!(!watch.lines(lines, PATIENCE).is_empty(), "no frame");
        worker.signal(Signal::STOP);
        eventually("a stale worker", || {
            get_json(&address, "/api/v1/fleet")["worker"]["state"] == "stale"
        });
        let seen = watch.lines(lines, PATIENCE);
        lines += seen.len();
        let shown: Value = serde_json::from_str(seen.last().unwrap()).unwrap();
        is_same(&address, &shown)
    });
    worker.signal(Signal::CONT);
}

#[test]
fn the_page_needs_nothing_that_docker_forbids() {
    let fleet = Fleet::new();
    let Some(command) = as_in_docker(&fleet.serve_command(&[])) else { return };
    let _worker = fleet.worker();
    let (_server, address) = fleet.serving(command);
    let _source = fleet.joulebus("publish sim --robots 6");
    eventually("six robots", || get_json(&address, "/api/v1/fleet")["totals"]["robots"] == 6);
    assert_eq!(get(&address, "/healthz").status, 200);
}

#[test]
fn the_next_page_works_when_the_kernel_has_killed_one_for_memory() {
    let Some(group) = MemoryGroup::new(160 << 20) else { return };
    let fleet = Fleet::new();
    let _worker = fleet.worker();
    let mut source = fleet.joulebus("publish sim --robots 6");
    for is_killed in [true, false] {
        let page = group.first_to_die(&fleet.serve_command(&[]));
        let (mut server, address) = fleet.serving(page);
        eventually("six robots", || get_json(&address, "/api/v1/fleet")["totals"]["robots"] == 6);
        if is_killed {
            group.exhaust();
            assert_eq!(server.wait().signal(), Some(9));
        } else {
            server.stop();
        }
    }
    source.end().exits(0);
}

/// True if fleet and robots equal a frame that `watch` shows.
fn is_same(address: &str, shown: &Value) -> bool {
    let fleet = get_json(address, "/api/v1/fleet");
    let mut robots = get_json(address, "/api/v1/robots?sort=robot")["robots"].clone();
    let stuck = get_json(address, "/api/v1/robots/3");
    // The page may have read one more frame in between.
    if stuck["stamp_ns"] != robots[3]["stamp_ns"] {
        return false;
    }
    for robot in robots.as_array_mut().unwrap() {
        robot.as_object_mut().unwrap().remove("sample_age_s");
        let platform = robot.as_object_mut().unwrap().remove("platform");
        assert_eq!(platform.unwrap(), "gternal");
    }
    let counts = [
        "tick",
        "ticks_skipped",
        "ticks_late",
        "samples_accepted",
        "samples_dropped",
        "model_hash",
    ];
    counts.iter().all(|name| fleet[*name] == shown[*name])
        && fleet["worker"]["pid"] == shown["worker_pid"]
        && fleet["worker"]["epoch"] == shown["worker_epoch"]
        && robots == shown["robots"]
}

#[test]
fn page_and_worker_name_a_platform_that_its_model_was_not_trained_for() {
    let fleet = Fleet::new();
    let text = std::fs::read_to_string(fleet.path()).unwrap() + "power_max_w = 5000.0\n";
    std::fs::write(fleet.path(), text).unwrap();
    let (_server, address) = fleet.serve(&[]);
    let found = get_json(&address, "/api/v1/fleet")["model_warnings"].to_string();
    assert_contains(&found, ["rover", "was trained on readings of", "5000 W"]);
    let mut worker = fleet.joulebus("run");
    worker.wait_for_line("was trained on readings of");
    worker.wait_for_line("ready:");
}

#[test]
fn a_stream_follows_a_worker_that_is_killed_and_comes_back() {
    let fleet = Fleet::new();
    let (_server, address) = fleet.serve(&[]);
    let mut events = Events::open(&address, "hz=10&robot=2");
    assert_eq!(events.view["fleet"]["worker"]["state"], "waiting");
    let unready = get(&address, "/readyz");
    assert_eq!((unready.status, unready.header("retry-after")), (503, Some("1")));
    assert!(unready.json()["error"].as_str().unwrap().contains("joulebus run"));
    let mut worker = fleet.worker();
    let _source = fleet.joulebus("publish sim --robots 4");
    events.until("robots", |view| {
        view["robots"]["total"] == 4 && view["robot"]["power_w"].is_number()
    });
    assert_eq!(events.view["robot"]["robot"], 2);
    // Not ready while the newest frame is older than two periods.
    eventually("it is ready", || get(&address, "/readyz").status == 200);
    let first = events.view["fleet"]["worker"]["pid"].clone();
    assert_eq!(first, worker.pid());
    worker.kill();
    events.until("the worker gone", |view| view["fleet"]["worker"]["state"] == "gone");
    // The last known robots are still shown.
    assert_eq!(events.view["robots"]["total"], 4);
    assert_eq!((get(&address, "/readyz").status, get(&address, "/healthz").status), (503, 200));
    let worker = fleet.worker();
    events.until("another worker", |view| {
        view["fleet"]["worker"]["state"] == "alive"
            && view["fleet"]["worker"]["pid"] == worker.pid()
    });
}

#[test]
fn an_alarm_is_acknowledged_by_whoever_may_ask_until_it_ends() {
    const JSON: &str = "Content-Type: application/json";
    let fleet = Fleet::new();
    let _worker = fleet.worker();
    let (_server, address) = fleet.serve(&[]);
    let mut source = fleet.joulebus("publish sim --robots 3");
    eventually("robots", || get_json(&address, "/api/v1/fleet")["totals"]["robots"] == 3);
    let of = |alarm: &str| json!({"robot": 1, "alarm": alarm, "by": "ann"}).to_string();
    let good = of("NoData");
    let new_normal = good.replace('}', ",\"new_normal\":true}");
    for (body, header, status, reason) in [
        (&*good, JSON, 409, "NoData of robot 1 is not raised"),
        (&of("WorkerGone"), JSON, 400, "allowed: NoData"),
        (&good.replace("ann", ""), JSON, 400, "is no name"),
        (&new_normal, JSON, 400, "allowed: LevelHigh, LevelLow"),
        (&good.replace('1', "-1"), JSON, 400, "openapi.json"),
        (&good, "Content-Type: text/plain", 415, "application/json"),
        (&good, "Content-Type: application/jsonp", 415, "application/json"),
        (&good, "Content-Type: Application/JSON; charset=utf-8", 409, "is not raised"),
        (&good, "Content-Type: application/json\r\nSec-Fetch-Site: cross-site", 403, ""),
    ] {
        let refused = acknowledge(&address, body, header);
        let output = refused.text();
        assert!(refused.status == status && output.contains(reason), "{body} {header}: {output}");
    }
    source.end();
    let by = |alarms: &Value| {
        let mut raised = alarms["raised"].as_array().unwrap().iter();
        let found = raised.find(|episode| episode["robot"] == 1 && episode["alarm"] == "NoData");
        found.map(|episode| episode["acknowledged"]["by"].clone())
    };
    let becomes = |what: &str, expected: Option<Value>| {
        eventually(what, || by(&get_json(&address, "/api/v1/alarms")) == expected);
    };
    becomes("silence", Some(Value::Null));
    let taken = acknowledge(&address, &good, JSON);
    assert_eq!(taken.text(), r#"{"robot":1,"alarm":"NoData","by":"ann","new_normal":false}"#);
    becomes("who", Some("ann".into()));
    let view = Events::open(&address, "").view;
    assert_eq!(by(&view["alarms"]), Some("ann".into()));
    let mut source = fleet.joulebus("publish sim --robots 3");
    becomes("its end", None);
    source.end();
    becomes("its return", Some(Value::Null));
}

#[test]
fn a_battery_is_stated_by_whoever_may_ask() {
    const JSON: &str = "Content-Type: application/json";
    let fleet = Fleet::new();
    let _worker = fleet.worker();
    let (_server, address) = fleet.serve(&[]);
    let mut source = fleet.joulebus("publish sim --robots 3");
    eventually("robots", || get_json(&address, "/api/v1/fleet")["totals"]["robots"] == 3);
    let state = |body: &Value| post(&address, "/api/v1/battery", &body.to_string(), JSON);
    for (body, status, reason) in [
        (json!({"robot": 1, "by": "ann"}), 400, "state one of"),
        (json!({"robot": 1, "by": "ann", "full": true, "charge": 0.5}), 400, "state one of"),
        (
            json!({"robot": 1, "by": "ann", "charge": 1.5}),
            400,
            "a state of charge of 1.5: allowed are 0 to 1",
        ),
        (json!({"robot": 1, "by": "", "full": true}), 400, "is no name"),
        (json!({"robot": 77_777, "by": "ann", "full": true}), 400, "of no platform"),
    ] {
        let refused = state(&body);
        let text = refused.text();
        assert!(refused.status == status && text.contains(reason), "{body}: {text}");
    }
    let taken = state(&json!({"robot": 1, "by": "ann", "charge": 0.5}));
    assert_eq!(taken.text(), r#"{"robot":1,"by":"ann","charge":0.5}"#);
    eventually("its charge", || {
        let robot = get_json(&address, "/api/v1/robots/1");
        let (soc, note) = (robot["soc"].as_f64().unwrap(), &robot["battery_note"]);
        robot["off"] == false && note.is_null() && (soc - 0.5).abs() < 0.01
    });
    source.end();
}

#[test]
fn months_of_learned_capacity_are_those_of_the_ledger() {
    let fleet = Fleet::new();
    let file = fleet.file("ledger.json");
    let text = fs::read_to_string(fleet.path()).unwrap();
    let saved = text.replace("checkpoint = \"\"", &format!("checkpoint = {file:?}"));
    assert_ne!(text, saved);
    fs::write(fleet.path(), saved).unwrap();
    let (_server, address) = fleet.serve(&[]);
    let of = |robot: u32| get(&address, &format!("/api/v1/robots/{robot}/capacity"));
    let none = json!({"robot": 3, "months": []});
    assert_eq!(of(3).json(), none);
    let months = json!([
        {"unix_s": 1_787_000_000_u64, "capacity_j": 36_000.0, "capacity_sd_j": 1_800.0},
        {"unix_s": 1_790_000_000_u64, "capacity_j": 32_400.0, "capacity_sd_j": 1_080.0},
    ]);
    let ledger = json!({
        "fleet": "http", "boot_id": "", "written_ns": 0, "written_unix_ns": 0, "robots": {},
        "capacities": {"3": months},
    });
    let sum = fnv1a(format!("[7,1,{ledger}]").bytes());
    let head = format!("{{\"schema\":7,\"generation\":1,\"fnv1a\":\"{sum:016x}\"");
    fs::write(&file, format!("{head},\"ledger\":{ledger}}}")).unwrap();
    assert_eq!(of(3).json(), json!({"robot": 3, "months": months}));
    // Half a file says nothing.
    fs::write(&file, head).unwrap();
    assert_eq!(of(3).json(), none);
    assert_eq!((of(77).status, get(&address, "/api/v1/robots/x/capacity").status), (404, 400));
}

/// A bridge writes what it finds beside the fleet's shared memory.
#[test]
fn what_a_source_finds_implausible_is_an_alarm_on_the_page_and_in_metrics() {
    let fleet = Fleet::new();
    let _worker = fleet.worker();
    let (_server, address) = fleet.serve(&[]);
    let config = joulebus_config::Config::load(fleet.path()).unwrap();
    let mut findings = FindingsFile::new(&config, "bridge");
    findings.write([(7, "sign: power is negative")]).unwrap();
    let is_raised = || {
        let alarms = get_json(&address, "/api/v1/alarms");
        let mut raised = alarms["raised"].as_array().unwrap().iter();
        raised.any(|one| one["robot"] == 7 && one["alarm"] == "Implausible")
    };
    eventually("the alarm", is_raised);
    let metrics = get(&address, "/metrics").text();
    let line = metrics.lines().find(|line| line.contains("alarm=\"Implausible\""));
    assert!(line.is_some_and(|line| line.ends_with(" 1.0")), "{metrics}");
    let cards = get_json(&address, "/api/v1/alarms/cards");
    let mut cards = cards.as_array().unwrap().iter();
    assert!(cards.any(|card| card["alarm"] == "Implausible"));
    drop(findings);
    eventually("its end", || !is_raised());
}

#[test]
fn an_alarm_appears_with_its_time_and_a_stream_adds_up_to_what_is_asked() {
    let fleet = Fleet::new();
    let mut worker = fleet.worker();
    let (_server, address) = fleet.serve(&[]);
    let mut events = Events::open(&address, "hz=10&sort=robot");
    let mut source = fleet.joulebus("publish sim --robots 5 --fault 1=stuck");
    events.until("an alarm", |view| {
        let raised = view["alarms"]["raised"].as_array().unwrap();
        raised.iter().any(|raised| raised["robot"] == 1 && raised["alarm"] == "StuckSensor")
    });
    let changes = events.view["alarms"]["changes"].as_array().unwrap();
    let mut changes = changes.iter().filter(|change| {
        change["robot"] == 1 && change["alarm"] == "StuckSensor" && change["change"] == "raised"
    });
    let change = changes.next().unwrap();
    assert_eq!(change["at_unix_ns"], change["raised_unix_ns"]);
    let now_unix_ns = events.view["fleet"]["now_unix_ns"].as_u64().unwrap();
    let at_unix_ns = change["at_unix_ns"].as_u64().unwrap();
    assert!(now_unix_ns.abs_diff(at_unix_ns) < PATIENCE.as_nanos() as u64, "{change}");
    events.until("the robot's alarm", |view| {
        view["robots"]["robots"][1]["alarms"][0] == "StuckSensor"
    });
    let found = get_json(&address, "/api/v1/robots?search=stucks&level=error");
    assert_eq!((&found["matched"], &found["robots"][0]["robot"]), (&json!(1), &json!(1)));
    let history = get_json(&address, "/api/v1/robots/1/history");
    assert_eq!(history["step_s"], 0.5);
    let points = history["reading_w"].as_array().unwrap();
    assert!(points.iter().any(Value::is_number), "{history}");
    assert_eq!(history["power_w"].as_array().unwrap().len(), points.len());
    let outlook = get_json(&address, "/api/v1/robots/1/outlook");
    assert_eq!(outlook["horizon_s"], json!([1.0, 10.0, 60.0, 300.0]));
    let joules = |place: usize| outlook["energy_j"][place].as_f64().unwrap();
    assert!(joules(0) > 0.0 && joules(3) > 100.0 * joules(0), "{outlook}");
    // From the first request on they are compared with the energy that is drawn.
    events.until("outlooks compared", |view| {
        view["fleet"]["ahead"][0]["compared"].as_u64() > Some(0)
    });
    // With the worker stopped, the sum of all deltas is what a new client gets.
    source.end();
    worker.stop();
    events.until("the worker's end", |view| view["fleet"]["worker"]["state"] == "gone");
    // A further look at the fleet may have been shown between the stream and the answer.
    events.until("the newest values", |view| {
        view["robots"] == get_json(&address, "/api/v1/robots?sort=robot")
            && view["alarms"] == get_json(&address, "/api/v1/alarms")
    });
}

#[test]
fn the_server_sorts_filters_and_cuts() {
    let fleet = Fleet::new();
    let _worker = fleet.worker();
    let (_server, address) = fleet.serve(&[]);
    let _source = fleet.joulebus("publish sim --robots 12");
    let _rovers = fleet.joulebus("publish sim --robots 3 --first-robot 100");
    eventually("fifteen robots", || get_json(&address, "/api/v1/robots")["total"] == 15);
    let ids = |query: &str| -> Vec<u64> {
        let robots = get_json(&address, &format!("/api/v1/robots?{query}"));
        let robots = robots["robots"].as_array().unwrap().clone();
        robots.iter().map(|robot| robot["robot"].as_u64().unwrap()).collect()
    };
    assert_eq!(ids("sort=robot&from=2&count=3"), [2, 3, 4]);
    assert_eq!(ids("sort=robot&descending=1&count=2"), [102, 101]);
    assert_eq!(ids("sort=robot&search=ROVER"), [100, 101, 102]);
    assert_eq!(ids("sort=robot&search=10"), [10, 100, 101, 102]);
    assert_eq!(ids("search=nothing"), Vec::<u64>::new());
    assert_eq!(ids("from=4000000000"), Vec::<u64>::new());
    let mut powers: Vec<f64> = Vec::new();
    eventually("powers", || {
        let robots = get_json(&address, "/api/v1/robots?sort=power&descending=1&count=200");
        let robots = robots["robots"].as_array().unwrap().iter();
        powers = robots.filter_map(|robot| robot["reading_w"].as_f64()).collect();
        powers.len() > 3
    });
    assert!(powers.is_sorted_by(|a, b| a >= b), "{powers:?}");
    for (query, expected) in [
        ("sort=age", "urgency"),
        ("descending=yes", "0 or 1"),
        ("count=0", "1 to 200"),
        ("count=201", "1 to 200"),
        ("from=-1", "from 0"),
        ("level=bad", "warn"),
        ("colour=red", "openapi.json"),
    ] {
        let refused = get(&address, &format!("/api/v1/robots?{query}"));
        assert_eq!(refused.status, 400, "{query}");
        let error = refused.json()["error"].as_str().unwrap().to_owned();
        assert!(error.contains(expected), "{query}: {error}");
    }
    assert_eq!(get(&address, "/api/v1/robots/77").status, 404);
    assert_eq!(get(&address, "/api/v1/robots/x").status, 400);
    assert_eq!(get(&address, "/api/v1/robots/77/history").status, 404);
    assert_eq!(get(&address, "/api/v1/robots/77/outlook").status, 404);
}

#[test]
fn a_question_is_answered_as_by_ask() {
    let fleet = Fleet::new();
    let _worker = fleet.worker();
    let _source = fleet.joulebus("publish sim --robots 3");
    let (_server, address) = fleet.serve(&[]);
    eventually("readings", || get(&address, "/api/v1/robots/1").json()["power_w"].is_number());
    let ask = |question: &Value| what_if(&address, &question.to_string());
    let answered = ask(&json!({"robot": 1, "idle_s": 20, "coverage": 0.8}));
    assert_eq!(answered.status, 200, "{}", answered.text());
    let answered = answered.json();
    let mut printed = Value::Null;
    // `ask` gives up if no frame is fresh in time.
    eventually("an answer of `ask`", || {
        let asked = fleet.joulebus("ask --robot 1 --idle 20 --coverage 0.8 --format json").wait();
        if asked.code() == Some(0) {
            printed = asked.json();
        }
        !printed.is_null()
    });
    let names =
        |value: &Value| -> Vec<String> { value.as_object().unwrap().keys().cloned().collect() };
    assert_eq!(names(&answered), names(&printed));
    let (one, other) = (&answered["answers"][0], &printed["answers"][0]);
    assert_eq!(names(one), names(other));
    for name in ["robot", "platform", "verdict", "duration_s"] {
        assert_eq!(one[name], other[name], "{name}");
    }
    let path = json!([{"x_m": 0, "y_m": 0}, {"x_m": 2, "y_m": 0, "speed_mps": 0.2}]);
    let trip = ask(&json!({"rank": [0, 2], "path": path, "return": "dock"})).json();
    assert_eq!(trip["answers"].as_array().unwrap().len(), 2, "{trip}");
    // The same way with a point each centimetre.
    let dense: Vec<Value> = (0..=200)
        .map(|cm| json!({"x_m": f64::from(cm) * 0.01, "y_m": 0, "speed_mps": 0.2}))
        .collect();
    let dense = ask(&json!({"rank": [0, 2], "path": dense, "return": "dock"})).json();
    assert_eq!(dense["answers"][0]["duration_s"], trip["answers"][0]["duration_s"], "{dense}");
    for (question, status) in [
        (json!({"robot": 9, "idle_s": 20}), 404),
        (json!({"robot": 1}), 400),
        (json!({"robot": 1, "idle_s": -1}), 400),
        (json!({"robot": 1, "idle_s": 20, "path": path}), 400),
        (json!({"robot": 1, "idle_s": 20, "colour": 1}), 400),
        (
            json!({"robot": 1, "path": [{"x_m": 0, "y_m": 0}, {"x_m": 2, "y_m": 0, "speed_mps": 9}]}),
            400,
        ),
        (json!({"idle_s": 20}), 400),
        (json!([]), 400),
    ] {
        let refused = ask(&question);
        assert_eq!(refused.status, status, "{question}: {}", refused.text());
        assert!(refused.json()["error"].is_string());
    }
    let plain = send(&address, &format!("POST /api/v1/what_if HTTP/1.1\r\nHost: {address}"), b"{}");
    assert_eq!(plain.status, 415);
}

#[test]
fn each_refusal_is_json_that_says_what_is_allowed() {
    let fleet = Fleet::new();
    let (_server, address) = fleet.serve(&[]);
    for (line, status, allowed) in [
        ("GET /api/v1/robots/%ff", 400, "allowed: 0 to 4294967295"),
        ("DELETE /", 405, "openapi.json"),
        ("OPTIONS *", 405, "openapi.json"),
    ] {
        let refused = send(&address, &format!("{line} HTTP/1.1\r\nHost: {address}"), b"");
        assert_eq!(refused.status, status, "{line}");
        assert_contains(refused.json()["error"].as_str().unwrap(), [allowed]);
    }
    let question = json!({"robot": 1, "return": "moon"}).to_string();
    assert_contains(&what_if(&address, &question).text(), ["return is ", "dock"]);
}

#[test]
fn every_file_of_the_page_is_served_and_nothing_else() {
    let fleet = Fleet::new();
    let (_server, address) = fleet.serve(&[]);
    let page = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/page"));
    let mut folders = vec![page.clone()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let name = format!("/{}", path.strip_prefix(&page).unwrap().display());
            let response = get(&address, &name);
            assert_eq!(
                (response.status, &response.body),
                (200, &fs::read(&path).unwrap()),
                "{name}"
            );
            assert!(
                response.header("content-security-policy").unwrap().contains("default-src 'self'")
            );
            assert_eq!(response.header("access-control-allow-origin"), None);
            let tag = response.header("etag").unwrap();
            let head = format!("GET {name} HTTP/1.1\r\nHost: {address}\r\nIf-None-Match: {tag}");
            assert_eq!(send(&address, &head, b"").status, 304);
        }
    }
    assert_eq!(get(&address, "/").body, fs::read(page.join("index.html")).unwrap());
    for path in [
        "/nothing",
        "/page",
        "/../Cargo.toml",
        "/..%2fCargo.toml",
        "/%2e%2e/Cargo.toml",
        "//etc/passwd",
        "/etc/passwd",
        "/index.html/",
        "/vendor",
        "/vendor/../../Cargo.toml",
        "/index.html%00",
    ] {
        assert_eq!(get(&address, path).status, 404, "{path}");
    }
}

#[test]
fn another_address_needs_a_token_and_clients_must_send_it() {
    let fleet = Fleet::new();
    let refused = |more: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_joulebus-serve"));
        command.args(["--config"]).arg(fleet.path()).args(more);
        let mut ended = joulebus_testkit::Child::spawn("serve", command);
        let ended = ended.wait();
        assert_eq!(ended.code(), Some(2), "{ended:?}");
        ended.errors()
    };
    assert!(refused(&["--http", "0.0.0.0:0"]).contains("--token-file"));
    let file = fleet.file("token");
    let path = file.to_str().unwrap();
    let write = |text: &str, mode| {
        fs::write(&file, text).unwrap();
        fs::set_permissions(&file, fs::Permissions::from_mode(mode)).unwrap();
    };
    let with_token = ["--http", "0.0.0.0:0", "--token-file", path];
    assert!(refused(&with_token).contains("token file"));
    write("0123456789abcdef", 0o644);
    assert!(refused(&with_token).contains("chmod 600"));
    write("short", 0o600);
    assert!(refused(&with_token).contains("5 characters"));
    write("0123456789abcdef\n", 0o600);
    let (_server, address) = fleet.serve(&with_token);
    let address = address.replace("0.0.0.0", "127.0.0.1");
    for path in [
        "/",
        "/api/v1/fleet",
        "/metrics",
        "/page.css",
        "/api/v1/stream",
        "/?token=0123456789abcdeX",
    ] {
        assert_eq!(get(&address, path).status, 401, "{path}");
    }
    assert!(get(&address, "/").text().contains("token"));
    assert_eq!(get(&address, "/healthz").status, 200);
    let entered = get(&address, "/?token=0123456789abcdef");
    assert_eq!((entered.status, entered.header("location")), (303, Some("/")));
    let cookie = entered.header("set-cookie").unwrap();
    assert_contains(&cookie, ["HttpOnly", "SameSite=Strict"]);
    let cookie = cookie.split(';').next().unwrap();
    for header in [format!("Cookie: {cookie}"), "Authorization: Bearer 0123456789abcdef".to_owned()]
    {
        let head = format!("GET /api/v1/fleet HTTP/1.1\r\nHost: {address}\r\n{header}");
        assert_eq!(send(&address, &head, b"").status, 200, "{header}");
    }
    let elsewhere =
        "GET / HTTP/1.1\r\nHost: evil.example\r\nAuthorization: Bearer 0123456789abcdef";
    assert_eq!(send(&address, elsewhere, b"").status, 403);
}

#[test]
fn signals_end_the_server_whatever_clients_do() {
    for signal in end_signals() {
        let fleet = Fleet::new();
        let (mut server, address) = fleet.serve(&["--webhook", "http://127.0.0.1:1/"]);
        server.wait_for_line("of alarms of fleet http");
        let _idle = client::dial(&address);
        let _events = Events::open(&address, "");
        server.signal(signal);
        let ended = server.wait();
        assert_eq!(ended.code(), Some(0), "{ended:?}");
        let report = ended.json();
        assert!(report["http"]["requests"].as_u64().unwrap() >= 1, "{report}");
        assert_eq!(report["webhooks"][0]["lost"], 0, "{report}");
        assert_eq!(fleet.stale_files(), Vec::<PathBuf>::new());
    }
}

#[test]
fn a_server_whose_shared_memory_is_removed_reports_it_and_exits_with_1() {
    for words in [&["--http", "127.0.0.1:0"][..], &["--webhook", "http://127.0.0.1:1/"]] {
        let fleet = Fleet::new();
        let mut worker = fleet.worker();
        let mut server = fleet.serve_alone(words);
        server.wait_for_line(" fleet http");
        fleet.stale_files().iter().for_each(|path| remove(path));
        let ended = server.wait();
        assert_eq!(ended.code(), Some(1), "{words:?}: {ended:?}");
        assert!(ended.text().is_empty(), "{words:?}: {ended:?}");
        assert_contains(&ended.errors(), ["error: ", "RemoveIPC"]);
        assert_eq!(worker.wait().code(), Some(1));
        // What they made meanwhile.
        fleet.stale_files().iter().for_each(|path| remove(path));
    }
}
