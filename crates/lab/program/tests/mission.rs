//! `joulebus mission`: a report as JSON.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

use joulebus_testkit::run;

#[test]
fn the_program_reports_as_json() {
    let program = env!("CARGO_BIN_EXE_joulebus-lab");
    let arguments = ["mission", "--seeds", "2", "--hours", "0.05", "--format", "json"];
    let made = run(program, arguments).exits(0);
    let report = made.json();
    let policies = report["policies"].as_array().unwrap();
    assert_eq!(policies.len(), 4);
    assert_eq!(policies[3]["name"], "joulebus");
    assert_eq!(policies[0]["outcomes"].as_array().unwrap().len(), 2);
    // Two seeds give no interval: null, not a number.
    assert!(policies[0]["tasks_per_h"]["lo"].is_null(), "{report}");
    assert_eq!(run(program, ["mission", "--hours", "NaN"]).exit_code(), 2);
}
