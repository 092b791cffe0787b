//! `joulebus calibrate` on simulated recordings and on captures of them.

use std::fs;
use std::path::PathBuf;
use std::process::Output;

use joulebus_config::Config;

use crate::fleet::{Exits as _, Fleet, code, joulebus, json, stderr};

/// Seven simulated robots of the platform gternal, 100 s each.
fn recordings(fleet: &Fleet) -> Vec<PathBuf> {
    let directory = fleet.path("simulated");
    joulebus(["data", "simulate", "--steps", "3000"]).arg(&directory).output().unwrap().exits(0);
    let robots = (1..=7).map(|robot| format!("energy_data_seven_robots_robot{robot}.npy"));
    robots.map(|name| directory.join(name)).collect()
}

fn calibrate(fleet: &Fleet, recordings: &[PathBuf], words: &str) -> Output {
    let mut command = joulebus(["calibrate", "--platform", "gternal"]);
    command.args(recordings).args(words.split_whitespace());
    command.arg("--config").arg(fleet.config()).output().unwrap()
}

#[test]
fn the_written_platform_has_the_limits_their_evidence_and_everything_else_as_before() {
    let fleet = Fleet::new();
    let recordings = recordings(&fleet);
    let file = fleet.path("robot-alarms.toml");
    let words = format!("--false-alarms 500/hour --robots 5 --format json -o {}", file.display());
    let found = calibrate(&fleet, &recordings, &words).exits(0);
    let found = json(&found);
    assert_eq!(found["wanted_per_robot_h"], 100.0);
    assert_eq!(found["robots"], 5);
    assert_eq!(found["delays"].as_array().unwrap().len(), 12, "{found}");
    assert_eq!(found["extrapolated"], false);

    let before = Config::load(fleet.config()).unwrap();
    let text = fs::read_to_string(fleet.config()).unwrap();
    let named = text.replace("builtin:gternal", "robot-alarms.toml");
    let renamed = fleet.path("calibrated.toml");
    fs::write(&renamed, named).unwrap();
    let after = Config::load(&renamed).unwrap_or_else(|error| panic!("{error}"));
    assert!(after.warnings().is_empty(), "{:?}", after.warnings());
    let [old, new] = [&before, &after].map(|config| config.settings().platforms[0].clone());
    let limits = new.alarms.unwrap();
    let values = [limits.noise_limit, limits.mismatch_limit, limits.level_limit];
    for (place, value) in values.into_iter().enumerate() {
        let stated = found["limits"][place]["value"].as_f64().unwrap();
        assert_eq!(value, stated as f32, "{found}");
    }
    assert_eq!(joulebus_settings::Platform { alarms: None, ..new }, old);
    assert_eq!(before.models(), after.models());
    let written = fs::read_to_string(&file).unwrap().replace("\n# ", " ");
    for evidence in [
        "robot-hours",
        "at 95 %",
        "rows",
        found["digest"].as_str().unwrap(),
        env!("CARGO_PKG_VERSION"),
    ] {
        assert!(written.contains(evidence), "{evidence}: {written}");
    }

    let again = calibrate(&fleet, &recordings, &words);
    assert_eq!(code(&again), 2, "nothing is overwritten");
    assert!(stderr(&again).contains("exists"), "{}", stderr(&again));
}

#[test]
fn a_capture_gives_what_its_recordings_give_and_the_number_of_robots() {
    let fleet = Fleet::new();
    let recordings = recordings(&fleet);
    let capture = fleet.path("fleet.mcap");
    let mut import = fleet.joulebus("import --format json");
    let imported = import.arg("-o").arg(&capture).args(&recordings).output();
    imported.unwrap().exits(0);
    let found = calibrate(&fleet, &[capture], "--false-alarms 700/hour --format json").exits(0);
    assert_eq!(json(&found)["robots"], 7);
    let trials = "--false-alarms 700/hour --robots 7 --format json";
    let same = calibrate(&fleet, &recordings, trials);
    let [found, same] = [json(&found), json(&same)];
    assert_eq!(found["limits"], same["limits"]);
}
