//! Implausible readings that are accepted, or only warned of.

use std::fs;

use joulebus_testkit::assert_contains;
use serde_json::Value;

use super::fleet::{Exits as _, Fleet, done, json, output, stderr, stdout};

/// A recording of 24 V and some 2 A at 30 Hz, whose current is negative while discharging.
fn negative(fleet: &Fleet) -> String {
    let mut text = "time,voltage_V,current_A,v_cmd,omega_cmd\n".to_owned();
    for row in 0..600 {
        let step = f64::from(row);
        let load_a = 0.15 + 0.02 * (0.7 * step).sin() + 0.01 * (2.9 * step).cos();
        let volt = 24.0 - 0.1 * load_a + 0.001 * (5.1 * step).sin();
        let [v, omega] = [0.1 + 0.01 * (0.3 * step).sin(), 0.2 * (0.21 * step).cos()];
        text += &format!("{},{volt},{},{v},{omega}\n", step / 30.0, -load_a);
    }
    let path = fleet.path("negative.csv");
    fs::write(&path, text).unwrap();
    path.display().to_string()
}

#[test]
fn what_is_accepted_is_reported_and_goes_on_in_text_and_json() {
    let fleet = Fleet::new();
    let path = negative(&fleet);
    let analyze = ["analyze", &path, "--split", "time", "--format", "json"];
    let accepted = done(analyze.into_iter().chain(["--accept", "sign"]));
    assert_contains(&stderr(&accepted), ["accepted: sign"]);
    let found = &json(&accepted)["implausible"][0];
    assert_eq!((&found["kind"], &found["accepted"]), (&Value::from("sign"), &Value::from(true)));
    output(["data", "check", &path, "--accept", "sign", "--format", "json"]).exits(0);
    let refused = output(["data", "check", &path, "--accept", "smell"]).exits(2);
    assert_contains(&stderr(&refused), ["saturation"]);
}

#[test]
fn warnings_are_shown_and_go_on() {
    let fleet = Fleet::new();
    let path = fleet.path("still.csv");
    let mut text = "time,power_W,current_A,v_cmd,omega_cmd\n".to_owned();
    for row in 0..300 {
        let step = f64::from(row);
        let power_w = 3.6 + 0.1 * (0.7 * step).sin();
        text += &format!("{},{power_w},0,0.1,{}\n", step / 30.0, 0.2 * (0.21 * step).cos());
    }
    fs::write(&path, text).unwrap();
    let analyze = ["analyze", path.to_str().unwrap(), "--split", "time"];
    let found = done(analyze.into_iter().chain(["--format", "json"]));
    assert_contains(&stderr(&found), ["warning: constant"]);
    let kind = &json(&found)["implausible"][0]["kind"];
    assert_eq!(kind, &Value::from("constant"));
}

/// The limits of a platform are those of a robot that consumes.
#[test]
fn a_platform_of_turned_readings_has_the_limits_of_a_robot() {
    let fleet = Fleet::new();
    let (path, out) = (negative(&fleet), fleet.path("lab"));
    let init = ["config", "init", "--from", &path, "--name", "r", "-o", out.to_str().unwrap()];
    let made = done(init.into_iter().chain(["--current", "discharge-negative"]));
    let platform = fs::read_to_string(out.join("platforms/r.toml")).unwrap();
    assert!(platform.contains("\npower_min_w = 0.0\n"), "{platform}");
    // The next commands read the recording in the same way.
    assert_contains(&stdout(&made), ["--current discharge-negative"]);
}

/// A zero in front of noise is no step of the monitor.
#[test]
fn noise_has_no_resolution() {
    let fleet = Fleet::new();
    let path = fleet.path("noise.csv");
    let mut text = "time,power_W\n0,0\n".to_owned();
    let mut state = 7_u64;
    for row in 1..3_000 {
        let mut sum = 0.0;
        for _ in 0..12 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            sum += (state >> 40) as f64 / f64::from(1 << 24);
        }
        text += &format!("{},{:.6}\n", f64::from(row) / 30.0, 4.6 + 0.3 * (sum - 6.0));
    }
    fs::write(&path, text).unwrap();
    let (path, out) = (path.display().to_string(), fleet.path("lab"));
    let made = done(format!("config init --from {path} -o {}", out.to_str().unwrap()).split(' '));
    assert!(!stdout(&made).contains("resolution"), "{}", stdout(&made));
}
