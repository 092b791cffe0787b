//! The metrics, read by programs that joulebus has no part in.

use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};

use joulebus_testkit::{eventually, free_port};
use serde_json::Value;

use super::client::{get, get_json, has_alarm};
use super::fleet::Fleet;

/// A Python with the package `prometheus_client`. Without one it logs that the test is skipped.
fn python() -> Option<String> {
    let named = std::env::var("JOULEBUS_PYTHON").ok();
    let usual = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/python/bin/python");
    let python = named.unwrap_or_else(|| usual.display().to_string());
    let mut probe = Command::new(&python);
    probe.args(["-c", "import prometheus_client.parser"]).stderr(Stdio::null());
    if probe.status().is_ok_and(|status| status.success()) {
        return Some(python);
    }
    assert!(
        std::env::var_os("CI").is_none_or(|ci| ci != "true"),
        "{python} lacks prometheus_client: tools/python.sh installs it"
    );
    eprintln!(
        "SKIPPED: {python} lacks prometheus_client (JOULEBUS_PYTHON=$(tools/python.sh) has it)"
    );
    None
}

/// The samples of a text as the parser understands it: name, labels and value.
fn parsed(python: &str, text: &str) -> Vec<Value> {
    let script = "import json, sys\n\
        from prometheus_client.parser import text_string_to_metric_families as parse\n\
        found = [[family.type, sample.name, sample.labels, sample.value]\n\
                 for family in parse(sys.stdin.read()) for sample in family.samples]\n\
        print(json.dumps(found))";
    let mut child = Command::new(python)
        .args(["-c", script])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    child.stdin.take().unwrap().write_all(text.as_bytes()).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "the parser refuses:\n{text}");
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn an_independent_parser_reads_the_metrics_and_finds_the_values_of_the_api() {
    let Some(python) = python() else { return };
    let fleet = Fleet::new();
    let mut worker = fleet.worker();
    let mut source = fleet.joulebus("publish sim --robots 7 --fault 2=stuck");
    let (_server, address) = fleet.serve(&["--metrics-robots", "5"]);
    eventually("an alarm", || has_alarm(&address, 2, "StuckSensor"));
    // A scrape has them computed for the next one.
    let ahead = |robot: &str| {
        let text = get(&address, "/metrics").text();
        let mut lines =
            text.lines().filter(|line| line.starts_with("joulebus_energy_ahead_joules{"));
        let labels = [robot, "horizon_s=\"10\"", "kind=\"hi\""];
        lines.any(|line| labels.iter().all(|label| line.contains(label)))
    };
    eventually("outlooks", || ahead("robot=\"4\""));
    assert!(!ahead("robot=\"5\""), "beyond the cap");
    source.end();
    worker.stop();
    eventually("the worker's end", || {
        get_json(&address, "/api/v1/fleet")["worker"]["state"] == "gone"
    });
    let response = get(&address, "/metrics");
    let kind = response.header("content-type").unwrap();
    assert!(kind.starts_with("text/plain; version=0.0.4"), "{kind}");
    let text = response.text();
    for line in text.lines().filter_map(|line| line.strip_prefix("# TYPE ")) {
        let (_, kind) = line.split_once(' ').unwrap();
        assert!(["counter", "gauge", "histogram"].contains(&kind), "{line}");
    }
    let samples = parsed(&python, &text);
    let value = |name: &str, label: &str, labelled: &str| -> Option<f64> {
        let mut found = samples.iter().filter(|sample| {
            sample[1] == name && (label.is_empty() || sample[2][label] == labelled)
        });
        let sample = found.next()?;
        assert_eq!(sample[2]["fleet"], "http");
        sample[3].as_f64()
    };
    let seen = get_json(&address, "/api/v1/fleet");
    let robot = get_json(&address, "/api/v1/robots/4");
    for (name, label, labelled, expected) in [
        ("joulebus_worker_up", "", "", &serde_json::json!(0)),
        ("joulebus_ticks_total", "", "", &seen["tick"]),
        ("joulebus_samples_accepted_total", "", "", &seen["samples_accepted"]),
        ("joulebus_robots", "level", "ok", &seen["totals"]["ok"]),
        ("joulebus_fleet_power_watts", "", "", &seen["totals"]["power_w"]),
        ("joulebus_consumed_joules_total", "robot", "4", &robot["drawn_j"]),
        ("joulebus_residual_watts", "robot", "4", &robot["residual_w"]),
        ("joulebus_robots_without_series", "", "", &serde_json::json!(2)),
    ] {
        let expected = expected.as_f64();
        let found = value(name, label, labelled);
        let close = found
            .zip(expected)
            .is_some_and(|(found, expected)| (found - expected).abs() <= 1e-9 * expected.abs());
        assert!(close, "{name}: {found:?}, expected {expected:?}");
    }
    assert_eq!(value("joulebus_alarms", "alarm", "StuckSensor"), Some(1.0));
    let consumed = value("joulebus_fleet_consumed_joules_total", "", "").unwrap();
    let drawn = seen["totals"]["drawn_j"].as_f64().unwrap();
    assert!(consumed >= drawn * 0.999, "{consumed} {drawn}");
    let count = value("joulebus_forecast_latency_seconds_count", "", "").unwrap();
    assert_eq!(value("joulebus_forecast_latency_seconds_bucket", "le", "+Inf"), Some(count));
    assert_eq!(value("joulebus_health_level", "robot", "5"), None, "beyond the cap");
    assert_eq!(value("joulebus_build_info", "version", env!("CARGO_PKG_VERSION")), Some(1.0));
}

/// A running Prometheus and its address. Without one it logs that the test is skipped.
fn prometheus(fleet: &Fleet, target: &str) -> Option<(joulebus_testkit::Child, String)> {
    let program = std::env::var("JOULEBUS_PROMETHEUS").unwrap_or_else(|_| "prometheus".to_owned());
    let mut probe = Command::new(&program);
    probe.arg("--version").stdout(Stdio::null()).stderr(Stdio::null());
    if !probe.status().is_ok_and(|status| status.success()) {
        assert!(
            std::env::var_os("CI").is_none_or(|ci| ci != "true"),
            "no {program}: tools/prometheus.sh installs it"
        );
        eprintln!("SKIPPED: no {program} (tools/prometheus.sh; JOULEBUS_PROMETHEUS names another)");
        return None;
    }
    let config = fleet.file("prometheus.yml");
    let text = format!(
        "global: {{scrape_interval: 1s}}\n\
         scrape_configs: [{{job_name: joulebus, static_configs: [{{targets: [\"{target}\"]}}]}}]\n"
    );
    std::fs::write(&config, text).unwrap();
    let free = format!("127.0.0.1:{}", free_port());
    let mut command = Command::new(program);
    command.arg(format!("--config.file={}", config.display()));
    command.arg(format!("--storage.tsdb.path={}", fleet.file("tsdb").display()));
    command.arg(format!("--web.listen-address={free}"));
    let mut child = joulebus_testkit::Child::spawn("prometheus", command);
    child.wait_for_line("Server is ready to receive web requests");
    Some((child, free))
}

/// The dashboard's queries, as of this fleet, with their panels.
fn dashboard() -> Vec<(String, String)> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../configs/grafana/joulebus.json");
    let dashboard: Value = serde_json::from_str(&std::fs::read_to_string(file).unwrap()).unwrap();
    let mut queries = Vec::new();
    for panel in dashboard["panels"].as_array().unwrap() {
        for target in panel["targets"].as_array().into_iter().flatten() {
            let query = target["expr"].as_str().unwrap();
            let query = query.replace("$__range", "1m");
            let query = query.replace("$__rate_interval", "1m");
            let query = query.replace("$fleet", "http").replace("$robot", ".+");
            let panel = panel["title"].as_str().unwrap();
            queries.push((panel.to_owned(), query));
        }
    }
    queries
}

/// Panels that may be empty: no robot of this fleet has a battery, no alarm may be raised, and
/// nothing may be refused.
const MAY_BE_EMPTY: [&str; 6] = [
    "Alarms raised",
    "Empty soonest",
    "State of charge",
    "Time to empty",
    "Samples dropped, by reason",
    "Questions about plans",
];

#[test]
fn a_real_prometheus_scrapes_the_metrics_and_answers_the_dashboard() {
    let fleet = Fleet::new();
    let _worker = fleet.worker();
    let _source = fleet.joulebus("publish sim --robots 3");
    let (_server, address) = fleet.serve(&[]);
    if let Some((mut prometheus, at)) = prometheus(&fleet, &address) {
        let value = |query: &str| -> Option<f64> {
            let answer = get(&at, &format!("/api/v1/query?query={query}"));
            let result = &answer.json()["data"]["result"];
            result[0]["value"][1].as_str()?.parse().ok()
        };
        eventually("a scrape", || value("up") == Some(1.0));
        eventually("the worker is seen", || value("joulebus_worker_up") == Some(1.0));
        eventually("three robots", || value("sum(joulebus_robots)") == Some(3.0));
        eventually("a robot's power", || {
            value("joulebus_power_watts%7Bkind=%22reading%22%7D").is_some()
        });
        eventually("a rate", || {
            value("rate(joulebus_ticks_total%5B1m%5D)").is_some_and(|rate| rate > 0.0)
        });
        for (panel, query) in dashboard() {
            let encoded: String = form_urlencoded::byte_serialize(query.as_bytes()).collect();
            eventually(&format!("an answer to {panel}: {query}"), || {
                let answer = get(&at, &format!("/api/v1/query?query={encoded}"));
                let answer = answer.json();
                assert_eq!(answer["status"], "success", "{panel}: {query}: {answer}");
                let result = answer["data"]["result"].as_array().unwrap();
                !result.is_empty() || MAY_BE_EMPTY.contains(&&*panel)
            });
        }
        prometheus.end();
    }
}
