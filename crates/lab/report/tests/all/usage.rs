//! What recordings say by themselves, against planted powers and speeds.

use std::fmt::Write as _;
use std::fs;

use joulebus_dataset::trial::Trial;
use joulebus_eval::score::{Design, Recording, recorded_platform};
use joulebus_report::{Document, Recorded, recorded};
use joulebus_settings::{Battery, Platform};
use serde_json::Value;

use super::live::settings;

/// Time, power, speed and turning. NaN is not recorded.
type Row = [f64; 4];

/// A run at 10 Hz: power and speed of each row.
fn run(rows: usize, of: impl Fn(usize) -> (f64, f64)) -> Vec<Row> {
    let row = |at: usize| {
        let (power_w, speed_mps) = of(at);
        [at as f64 / 10.0, power_w, speed_mps, 0.0]
    };
    (0..rows).map(row).collect()
}

fn recordings(runs: &[Vec<Row>]) -> Vec<Recording> {
    let folder = tempfile::tempdir().unwrap();
    let written = runs.iter().enumerate().map(|(at, rows)| {
        let mut text = "timestamp_s,power_W,v_cmd_mps,omega_cmd_radps\n".to_owned();
        for [time_s, power_w, speed_mps, turning_radps] in rows {
            writeln!(text, "{time_s},{power_w},{speed_mps},{turning_radps}").unwrap();
        }
        let path = folder.path().join(format!("run_{at}.csv"));
        fs::write(&path, text).unwrap();
        Recording::new(0, Trial::read(path).unwrap())
    });
    written.collect()
}

fn report(runs: &[Vec<Row>], platform: Option<&Platform>, battery_wh: Option<f64>) -> Document {
    let recordings = recordings(runs);
    let design = Design::folds(&recordings);
    let what = Recorded {
        settings: &settings(),
        platform,
        models: &[],
        recordings: &recordings,
        design: &design,
        references: Vec::new(),
        battery_wh,
    };
    recorded(&what).unwrap()
}

fn rows(document: &Document, id: &str) -> Vec<Value> {
    let json = serde_json::to_value(document).unwrap();
    let parts = json["sections"][0]["parts"].as_array().unwrap().clone();
    let mut tables = parts.iter().filter_map(|part| part.get("table"));
    let table = tables.find(|table| table["id"] == id).unwrap();
    table["rows"].as_array().unwrap().clone()
}

fn near(found: &Value, wanted: f64) {
    let number = found.as_f64().unwrap_or(f64::NAN);
    assert!((number / wanted - 1.0).abs() < 1e-6, "{found}, wanted {wanted}");
}

fn says(document: &Document, words: &[&str]) {
    let text = document.to_string();
    for words in words {
        assert!(text.contains(words), "{words} in\n{text}");
    }
}

/// 36 W at 1 m/s: 0.01 Wh per metre.
fn steady(rows: usize) -> Vec<Row> {
    run(rows, |at| (36.0 + if at % 2 == 0 { 0.5 } else { -0.5 }, 1.0))
}

#[test]
fn energy_per_metre_and_a_batterys_hours_are_those_of_the_planted_power_and_speed() {
    let document = report(&[steady(1001)], None, Some(72.0));
    let run = &rows(&document, "table-runs")[0];
    near(&run["energy_per_metre_wh"], 0.01);
    near(&run["distance_m"], 100.0);
    near(&run["energy_wh"], 1.0);
    let battery = rows(&document, "table-battery");
    near(&battery[0]["lasts_h"], 2.0);
    near(&battery[0]["distance_m"], 7200.0);
    says(
        &document,
        &[
            "Energy per metre: 0.0100 Wh",
            "A battery of 72.0 Wh lasts 2.00 h",
            "1001 of 1001 rows have a plausible power",
            "Speeds are the commanded ones",
        ],
    );
}

#[test]
fn what_is_missing_implausible_or_out_of_order_counts_for_nothing_and_is_counted() {
    let clean = report(&[steady(1001)], None, None);
    let mut rows_of = steady(1001);
    for at in (50..950).step_by(97) {
        rows_of[at][1] = f64::NAN;
    }
    for at in (60..950).step_by(101) {
        rows_of[at][1] = 900_000.0;
    }
    for at in (70..950).step_by(103) {
        rows_of[at][2] = 4_000.0;
    }
    // A row that repeats the time of the row before it, with a power of its own.
    let twice = [rows_of[500][0], 9_000.0, 1.0, 0.0];
    rows_of.insert(501, twice);
    let spoilt = report(&[rows_of], None, None);
    let [clean, spoiled] = [&clean, &spoilt].map(|one| rows(one, "table-runs")[0].clone());
    let found = spoiled["energy_per_metre_wh"].as_f64().unwrap();
    let wanted = clean["energy_per_metre_wh"].as_f64().unwrap();
    assert!((found / wanted - 1.0).abs() < 1e-3, "{found}, wanted {wanted}");
    says(
        &spoilt,
        &[
            "10 have no power",
            "9 have an implausible power",
            "1 have a time that does not advance",
            "The speed of 9 is implausible",
        ],
    );
}

#[test]
fn a_long_pause_is_not_metered_and_charging_is_no_consumption() {
    let mut paused = steady(1001);
    for row in &mut paused[500..] {
        row[0] += 3600.0;
    }
    let found = report(&[paused], None, None);
    let run = &rows(&found, "table-runs")[0];
    near(&run["energy_per_metre_wh"], 0.01);
    assert!(run["energy_wh"].as_f64().unwrap() < 1.01, "{run}");
    says(&found, &["3600 s between readings that are far apart are not metered"]);
    // At rest on its charger, for a minute in the middle.
    let mut charged = steady(1601);
    for row in &mut charged[500..1100] {
        (row[1], row[2]) = (-30.0 - (row[0] % 3.0), 0.0);
    }
    let found = report(&[charged], None, None);
    let run = &rows(&found, "table-runs")[0];
    near(&run["energy_per_metre_wh"], 0.01);
    says(&found, &["600 are on the charger"]);
}

#[test]
fn without_speed_capacity_or_a_second_run_the_answers_are_not_known() {
    let still = run(300, |at| (10.0 + (at % 3) as f64, f64::NAN));
    let document = report(&[still], None, None);
    says(
        &document,
        &[
            "Energy per metre is not known: no plausible speed is recorded. The mean power is 11.0 W.",
            "How long a battery lasts is not known",
            "Which run is the worst is not known",
            "speed not known",
        ],
    );
    let found = &rows(&document, "table-runs")[0];
    assert!(found["energy_per_metre_wh"].is_null() && found["distance_m"].is_null(), "{found}");
    let standing = run_at_rest();
    says(&report(&[standing], None, None), &["the robots moved less than a metre"]);
    // A robot that only charges its battery empties none.
    let charging = run(300, |at| (-5.0 - (at % 3) as f64 / 10.0, 1.0));
    says(&report(&[charging], None, Some(20.0)), &["no power is recorded that empties it"]);
}

fn run_at_rest() -> Vec<Row> {
    run(300, |at| (10.0 + (at % 3) as f64, 0.0))
}

#[test]
fn the_powers_at_rest_turning_and_by_speed_are_the_planted_ones() {
    let law = |speed_mps: f64| 4.0 + 10.0 * speed_mps;
    let mut driven = run(3000, |at| {
        let speed_mps = [0.0, 0.25, 0.55][at / 1000];
        (law(speed_mps) + if at % 2 == 0 { 0.01 } else { -0.01 }, speed_mps)
    });
    for row in &mut driven[..500] {
        (row[1], row[3]) = (7.0 + row[1] - 4.0, 0.5);
    }
    let found = rows(&report(&[driven], None, None), "table-speed");
    let mean = |words: &str| {
        let row = found.iter().find(|row| row["speed"] == words);
        row.unwrap_or_else(|| panic!("{words} of {found:#?}"))["mean_w"].as_f64().unwrap()
    };
    for (words, wanted) in [
        ("at rest", 4.0),
        ("turning on the spot", 7.0),
        ("0.25 to 0.30 m/s", 6.5),
        ("0.50 m/s and above", 9.5),
    ] {
        // The steps between two speeds are of both.
        assert!((mean(words) - wanted).abs() < 0.05, "{words}: {}", mean(words));
    }
}

#[test]
fn the_range_of_a_battery_is_that_of_the_runs_or_of_the_tenths_of_a_single_one() {
    let at = |power_w: f64| run(500, move |at| (power_w + (at % 2) as f64 * 0.01, 0.5));
    let found = rows(&report(&[at(10.0), at(20.0), at(40.0)], None, Some(80.0)), "table-battery");
    let hours = |row: &Value| row["lasts_h"].as_f64().unwrap();
    assert!((hours(&found[1]) - 2.0).abs() < 0.01, "{found:?}");
    assert!((hours(&found[2]) - 8.0).abs() < 0.01, "{found:?}");
    assert!(hours(&found[1]) < hours(&found[0]) && hours(&found[0]) < hours(&found[2]));
    assert_eq!(found[1]["at"], "the hungriest run");
    // Of many runs, the ends of a range are no longer runs.
    let many: Vec<_> = (10..30).map(|power_w| at(f64::from(power_w))).collect();
    let found = rows(&report(&many, None, Some(80.0)), "table-battery");
    assert_eq!(found[1]["at"], "the upper end of 90 % of the runs");
    let one = run(1000, |at| (if at < 500 { 10.0 } else { 20.0 } + (at % 2) as f64 * 0.01, 0.5));
    let found = rows(&report(&[one], None, Some(80.0)), "table-battery");
    assert!((hours(&found[1]) - 4.0).abs() < 0.1, "{found:?}");
    assert!((hours(&found[2]) - 8.0).abs() < 0.1, "{found:?}");
}

#[test]
fn the_platforms_capacity_reserve_and_limits_hold() {
    let trial = recordings(&[steady(10)])[0].contents().unwrap().trial.clone();
    let mut platform = recorded_platform(0, &trial);
    platform.battery = Some(Battery { reserve: 0.25, ..Battery::new(3600.0 * 96.0, 0.5) });
    (platform.power_min_w, platform.power_max_w, platform.v_max_mps) = (0.0, 50.0, 2.0);
    let mut rows_of = steady(1001);
    rows_of[300][1] = 60.0;
    let document = report(&[rows_of], Some(&platform), None);
    says(&document, &["1 have an implausible power", "down to a reserve of 25 %"]);
    let hours = rows(&document, "table-battery")[0]["lasts_h"].as_f64().unwrap();
    assert!((hours - 2.0).abs() < 1e-3, "{hours}");
}

#[test]
fn the_worst_run_is_named_with_the_reason_that_was_planted() {
    let law = |speed_mps: f64| 4.0 + 10.0 * speed_mps;
    let drive = |factor: f64, slow: usize| {
        run(2000, move |at| {
            let speed_mps = if at % 100 < slow { 0.1 } else { 0.5 };
            (factor * law(speed_mps) + (at % 2) as f64 * 0.01, speed_mps)
        })
    };
    let dragging = report(&[drive(1.0, 20), drive(1.8, 20), drive(1.0, 20)], None, None);
    says(
        &dragging,
        &["Worst run: run 1", "80 % more power", "So it is mostly the robot, its load"],
    );
    assert_eq!(rows(&dragging, "table-runs")[0]["run"], "run 1");
    let slow = report(&[drive(1.0, 20), drive(1.0, 20), drive(1.0, 95)], None, None);
    says(&slow, &["Worst run: run 2", "So it is mostly how it was driven"]);
    let same = report(&[drive(1.0, 20), drive(1.0, 20)], None, None);
    says(&same, &["It hardly differs from them."]);
    let unknown = |power_w: f64| run(300, move |at| (power_w + (at % 3) as f64, f64::NAN));
    let found = report(&[unknown(5.0), unknown(9.0)], None, None);
    says(&found, &["Worst run: run 1, 10.0 W", "Why is not known: the speeds are not."]);
}
