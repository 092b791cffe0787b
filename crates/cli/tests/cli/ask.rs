//! Questions about plans, answered from a running worker's shared memory.

use std::fs;
use std::process::Output;

use joulebus_testkit::eventually;
use rustix::process::Signal;
use serde_json::Value;

use crate::fleet::{Fleet, Program, code, json, stderr, stdout};

/// A fleet whose first platform has a battery.
fn fleet() -> Fleet {
    let fleet = Fleet::new();
    let text = fs::read_to_string(fleet.config()).unwrap();
    let robots = "robots = [\"0-9\"]\n";
    assert!(text.contains(robots), "{text}");
    let battery = "[platform.battery]\ncapacity_wh = 5.0\ninitial_soc_lo = 0.95\n";
    let text = text.replace(robots, &format!("{robots}{battery}"));
    fs::write(fleet.config(), text).unwrap();
    let path = "x_m,y_m,speed_mps\n0,0,\n1.5,0,0.15\n1.5,0.5,0.1\n";
    fs::write(fleet.path("p.csv"), path).unwrap();
    fleet
}

/// Asks until every robot's energy is known: a simulated fleet has just begun.
fn ask(fleet: &Fleet, question: &str) -> Value {
    let path = fleet.path("p.csv").display().to_string();
    let question = format!("ask --format json {}", question.replace("FILE", &path));
    let mut last = Value::Null;
    eventually("answers", || {
        let asked = fleet.output(&question);
        if code(&asked) != 0 {
            return false;
        }
        last = json(&asked);
        let answers = last["answers"].as_array().unwrap();
        answers.iter().all(|answer| answer["energy"].is_object())
    });
    last
}

/// The outcome of a question, once it is as expected. Retries, because a process without a
/// processor for three seconds finds no worker.
fn outcome(fleet: &Fleet, question: &str, is_expected: impl Fn(&Output) -> bool) -> Output {
    let mut found = None;
    eventually(question, || {
        let asked = fleet.output(question);
        let is_it = is_expected(&asked);
        if !is_it {
            println!("{question}: {asked:?}");
        }
        found = is_it.then_some(asked);
        is_it
    });
    found.unwrap()
}

/// Same as [`outcome`], of a question that is refused with an exit code and such a reason.
fn refused(fleet: &Fleet, question: &str, with: i32, expected: &str) {
    let asked =
        outcome(fleet, question, |asked| code(asked) == with && stderr(asked).contains(expected));
    assert!(stdout(&asked).is_empty(), "{asked:?}");
}

#[test]
fn a_running_fleet_answers_what_a_plan_costs_and_which_robot_does_it_for_the_least() {
    let fleet = fleet();
    let worker = fleet.worker();
    let source = Program::start(fleet.joulebus("publish sim --robots 4"));

    let asked = ask(&fleet, "--robot 1 --path FILE --return dock");
    assert_eq!(asked["fleet"], "cli");
    let answer = &asked["answers"][0];
    assert_eq!(answer["robot"], 1);
    assert_eq!(answer["platform"], "gternal");
    let number = |value: &Value| value.as_f64().unwrap_or_else(|| panic!("{asked}"));
    let energy = &answer["energy"];
    let [lo_j, mean_j, hi_j] = ["lo_j", "mean_j", "hi_j"].map(|end| number(&energy[end]));
    // Without a calibrated energy model the interval is what the platform can draw, from 0 W on.
    assert!(-0.01 < lo_j && lo_j <= mean_j && mean_j <= hi_j, "{asked}");
    // A robot that draws 2 to 6 W for the time of two metres and back.
    let mean_w = mean_j / number(&answer["duration_s"]);
    assert!((2.0..6.0).contains(&mean_w), "{asked}");
    let left = &answer["left"];
    let (left_j, left_lo_j) = (number(&left["mean_j"]), number(&left["lo_j"]));
    assert!(left_lo_j <= left_j && left_j < 5.0 * 3600.0 - lo_j, "{asked}");
    assert_ne!(answer["verdict"], "no", "{asked}");
    assert_ne!(answer["verdict"], "unknown", "{asked}");

    let power = ask(&fleet, "--robot 1 --path FILE --power");
    let answer = &power["answers"][0];
    let steps = answer["power_w"].as_array().unwrap();
    let sum_j: f64 = steps.iter().map(|power_w| number(power_w) / 30.0).sum();
    let mean_j = number(&answer["energy"]["mean_j"]);
    assert!((sum_j - mean_j).abs() < 1e-3 * mean_j, "{sum_j} {mean_j}");

    let ranked = ask(&fleet, "--rank 0,2-3 --path FILE");
    let answers = ranked["answers"].as_array().unwrap();
    let of = |name: &str| -> Vec<f64> {
        let found = answers.iter().map(|answer| number(&answer[name]));
        found.collect()
    };
    let mut robots = of("robot");
    robots.sort_by(f64::total_cmp);
    assert_eq!(robots, [0.0, 2.0, 3.0]);
    let costs: Vec<f64> =
        answers.iter().map(|answer| number(&answer["energy"]["mean_j"])).collect();
    assert!(costs.is_sorted(), "one verdict, the cheapest first: {ranked}");

    // A robot that is not there is named beside the others' answers.
    for through in ["", " --through worker"] {
        let ranked = ask(&fleet, &format!("--rank 0,9,2 --path FILE{through}"));
        assert_eq!(ranked["missing"], serde_json::json!([9]), "{ranked}");
        assert_eq!(ranked["answers"].as_array().map(Vec::len), Some(2), "{ranked}");
    }

    let answered = outcome(&fleet, "ask --robot 2 --idle 30", |asked| code(asked) == 0);
    assert!(stdout(&answered).starts_with("robot 2 (gternal): "), "{answered:?}");
    // A robot that is not there, and a dock of words.
    refused(&fleet, "ask --robot 9 --idle 30", 1, "robot 9");
    let nowhere = fleet.output("ask --robot 1 --path p.csv --return home");
    assert_eq!(code(&nowhere), 2, "{nowhere:?}");

    source.end(Signal::INT);
    assert_eq!(code(&worker.end(Signal::INT)), 0);
    assert!(fleet.stale_files().is_empty());
}

#[test]
fn a_robot_whose_sensor_is_stuck_is_never_yes_and_is_ranked_behind_the_others() {
    let fleet = fleet();
    let worker = fleet.worker();
    let source = Program::start(fleet.joulebus("publish sim --robots 3 --fault 1=stuck"));
    let path = fleet.path("p.csv").display().to_string();
    let named = |asked: &Output| stdout(asked).contains("StuckSensor");
    for through in ["", " --through worker"] {
        let question = format!("ask --robot 1 --path {path}{through}");
        let text = stdout(&outcome(&fleet, &question, named));
        assert!(!text.starts_with("robot 1 (gternal): yes"), "{text}");
        for plan in ["--path FILE", "--idle 20"] {
            let ranked = ask(&fleet, &format!("--rank 1,2,0 {plan}{through}"));
            let answers = ranked["answers"].as_array().unwrap();
            assert_eq!(answers[2]["robot"], 1, "{ranked}");
            assert_eq!(answers[2]["probability"], Value::Null, "{ranked}");
            assert_eq!(answers[2]["caveats"]["alarms"][0], "StuckSensor", "{ranked}");
            assert_eq!(answers[0]["caveats"]["alarms"], serde_json::json!([]), "{ranked}");
        }
    }
    let endless = outcome(&fleet, &format!("ask --robot 0 --path {path} --speed inf"), |_| true);
    assert_eq!(code(&endless), 2, "{}", stderr(&endless));
    source.end(Signal::INT);
    assert_eq!(code(&worker.end(Signal::INT)), 0);
}

#[test]
fn an_hour_at_rest_has_a_probability_that_is_extrapolated_and_a_bound_of_what_is_spare() {
    let fleet = fleet();
    let worker = fleet.worker();
    let source = Program::start(fleet.joulebus("publish sim --robots 1"));
    let answered = ask(&fleet, "--robot 0 --idle 3600");
    let answer = &answered["answers"][0];
    assert_eq!(answer["caveats"]["beyond_horizon"], true, "{answered}");
    assert!(answer["probability"].as_f64().unwrap() > 0.9, "{answered}");
    let [lo_j, hi_j] = ["lo_j", "hi_j"].map(|end| answer["energy"][end].as_f64().unwrap());
    assert!(hi_j < 1.5 * lo_j, "not what the platform could draw: {answered}");
    let text = stdout(&fleet.output("ask --robot 0 --idle 3600"));
    for expected in ["extrapolated", "spare   at least", "upper bound of the energy"] {
        assert!(text.contains(expected), "{text}");
    }
    source.end(Signal::INT);
    assert_eq!(code(&worker.end(Signal::INT)), 0);
}

#[test]
fn a_trip_has_waits_loads_docking_and_times_and_its_charge_is_stated_along_it() {
    let fleet = fleet();
    let text = fs::read_to_string(fleet.config()).unwrap();
    let docking = "capacity_wh = 5.0\ndocking_wh = 0.02";
    fs::write(fleet.config(), text.replace("capacity_wh = 5.0", docking)).unwrap();
    let worker = fleet.worker();
    let source = Program::start(fleet.joulebus("publish sim --robots 1"));
    let trip = "x_m,y_m,speed_mps,dwell_s,load_w\n0,0,,,\n2,0,0.15,30,3\n2,1,0.15,,\n";
    let mut stairs = "x_m,y_m\n0,0\n".to_owned();
    for cell in 0..60 {
        let [now, next] = [cell, cell + 1].map(|cells| 0.05 * f64::from(cells));
        stairs += &format!("{next},{now}\n{next},{next}\n");
    }
    let paths = [
        ("plain.csv", "x_m,y_m,speed_mps\n0,0,\n2,0,0.15\n2,1,0.15\n".to_owned()),
        ("trip.csv", trip.to_owned()),
        ("late.csv", "x_m,y_m,time_s\n0,0,7\n2,0,8\n2,1,47\n".to_owned()),
        ("stairs.csv", stairs),
    ];
    let [plain, trip, late, stairs] = paths.map(|(name, text)| {
        fs::write(fleet.path(name), text).unwrap();
        format!("--robot 0 --path {}", fleet.path(name).display())
    });
    let mean_j = |asked: &Value| asked["answers"][0]["energy"]["mean_j"].as_f64().unwrap();
    for through in ["", " --through worker"] {
        let asked = |question: &str| ask(&fleet, &format!("{question}{through}"));
        let [there, back] = ["", " --return dock"].map(|end| asked(&format!("{trip}{end}")));
        // Half a minute at rest, 3 W for it and for two metres.
        let more_j = mean_j(&there) - mean_j(&asked(&plain));
        assert!(more_j > 3.0 * 43.0 + 20.0, "{more_j} J: {there}");
        assert!(mean_j(&back) > mean_j(&there) + 72.0, "docking: {back}");
        let along = back["answers"][0]["along"].as_array().unwrap();
        let of = |name: &str| -> Vec<f64> {
            along.iter().map(|moment| moment[name].as_f64().unwrap()).collect()
        };
        assert_eq!(along.len(), 48);
        assert!(of("time_s").is_sorted(), "{back}");
        assert_eq!(along[47]["energy"], back["answers"][0]["energy"]);
        for moment in along {
            let charge: Vec<f64> = serde_json::from_value(moment["charge"].clone()).unwrap();
            let [mean, lo, hi] = charge[..] else { panic!("{moment}") };
            assert!(0.0 < lo && lo <= mean && mean <= hi && hi <= 1.0, "{moment}");
        }
        let late_s = asked(&late)["answers"][0]["caveats"]["late_s"].as_u64().unwrap();
        assert!((5..15).contains(&late_s), "{late_s} s");
        let cut = asked(&stairs);
        assert_eq!(cut["path"]["points"], 121, "{cut}");
        assert!(cut["path"]["lines"].as_u64().unwrap() < 5, "{cut}");
        let driven = asked(&format!("{stairs} --tolerance 0"));
        assert!(driven["path"].is_null() && mean_j(&driven) > 1.2 * mean_j(&cut), "{driven}");
    }
    let text = stdout(&fleet.output(&format!("ask {trip} --return dock")));
    assert!(text.contains("\n  charge  ") && text.contains(" % ("), "{text}");
    assert!(stdout(&fleet.output(&format!("ask {late}"))).contains("times cannot be kept"));
    let text = stdout(&fleet.output(&format!("ask {stairs}")));
    assert!(text.starts_with("path of 121 points: driven as "), "{text}");
    source.end(Signal::INT);
    assert_eq!(code(&worker.end(Signal::INT)), 0);
}

#[test]
fn a_speed_above_the_platforms_is_refused_with_its_greatest() {
    let fleet = fleet();
    let path = fleet.path("fast.csv").display().to_string();
    let none = "x_m,y_m\n0,0\n1,0\n";
    // The speed of the first point is not used.
    let stated = "x_m,y_m,speed_mps\n0,0,99\n1,0,0.1\n1,1,99\n";
    for (text, question, expected) in [
        (none, "--robot 1 --speed 99", "towards point 1"),
        (none, "--rank 2,1 --speed 99 --through worker", "at most 0."),
        (none, "--robot 1 --speed 99 --format json", "v_max_mps"),
        (stated, "--robot 1", "99 m/s towards point 2"),
    ] {
        fs::write(&path, text).unwrap();
        let asked = fleet.output(&format!("ask --path {path} {question}"));
        assert_eq!(code(&asked), 2, "{asked:?}");
        assert!(stderr(&asked).contains(expected), "{asked:?}");
        assert!(stdout(&asked).is_empty(), "{asked:?}");
    }
    // The greatest itself, and none: there is only no worker.
    fs::write(&path, none).unwrap();
    for question in ["--robot 1 --speed 0.25", "--robot 1"] {
        let asked = fleet.output(&format!("ask --path {path} {question}"));
        assert_eq!(code(&asked), 1, "{asked:?}");
    }
}

#[test]
fn a_planner_with_another_model_or_other_limits_than_the_worker_is_refused() {
    let fleet = fleet();
    let worker = fleet.worker();
    let source = Program::start(fleet.joulebus("publish sim --robots 2"));
    ask(&fleet, "--robot 1 --idle 10");
    let text = fs::read_to_string(fleet.config()).unwrap();
    for (change, expected) in
        [("capacity_wh = 6.0", "settings"), ("capacity_wh = 5.0\ninitial_soc = 0.97", "settings")]
    {
        fs::write(fleet.config(), text.replace("capacity_wh = 5.0", change)).unwrap();
        refused(&fleet, "ask --robot 1 --idle 10", 1, expected);
    }
    let gternal = "file = \"builtin:gternal\"";
    let other = format!("{gternal}\nmodel = \"builtin:gternal-sim-power\"");
    fs::write(fleet.config(), text.replace(gternal, &other)).unwrap();
    refused(&fleet, "ask --robot 1 --idle 10", 1, "model");
    fs::write(fleet.config(), text).unwrap();
    source.end(Signal::INT);
    assert_eq!(code(&worker.end(Signal::INT)), 0);
}

#[test]
fn the_worker_answers_the_same_questions_with_the_same_exit_codes() {
    let fleet = fleet();
    let none = fleet.output("ask --robot 1 --idle 10 --through worker");
    assert_eq!(code(&none), 1, "{none:?}");
    assert!(stderr(&none).contains("joulebus run"), "{none:?}");
    let worker = fleet.worker();
    let source = Program::start(fleet.joulebus("publish sim --robots 4"));
    for question in [
        "--robot 1 --idle 10",
        "--robot 1 --path FILE --return dock --power",
        "--rank 0,3,2 --path FILE",
    ] {
        let here = ask(&fleet, question);
        let there = ask(&fleet, &format!("{question} --through worker"));
        // Ticks later: the same fields, robots and lengths.
        let shape = |asked: &Value| -> Vec<String> {
            let answers = asked["answers"].as_array().unwrap();
            let mut shapes: Vec<String> = answers
                .iter()
                .map(|answer| {
                    let fields = answer.as_object().unwrap().keys();
                    let steps = answer["power_w"].as_array().map_or(0, Vec::len);
                    let (robot, platform) = (&answer["robot"], &answer["platform"]);
                    format!("{robot} {platform} {steps} {:?}", fields.collect::<Vec<_>>())
                })
                .collect();
            shapes.sort();
            shapes
        };
        assert_eq!(shape(&here), shape(&there), "{here}\n{there}");
    }
    refused(&fleet, "ask --robot 9 --idle 30 --through worker", 1, "robot 9");
    refused(&fleet, "ask --robot 1 --idle 3 --coverage 0.2 --through worker", 2, "");
    let many = (0..65).map(|robot| robot.to_string()).collect::<Vec<_>>();
    let many = many.join(",");
    let large = fleet.output(&format!("ask --rank {many} --idle 3 --through worker"));
    assert_eq!(code(&large), 2, "{large:?}");
    assert!(stderr(&large).contains("65 robots"), "{large:?}");
    // The worker states its counts within half a second.
    eventually("the counts are shown", || {
        let seen = fleet.output("watch --once --format json");
        if code(&seen) != 0 {
            return false;
        }
        let seen = json(&seen);
        let refused = |reason: &str| seen["questions_refused"][reason].as_u64() >= Some(1);
        let answered = seen["questions_answered"].as_u64() >= Some(3);
        answered && refused("UnknownRobot") && refused("Question")
    });
    let report = json(&worker.end(Signal::INT));
    let queries = &report["queries"];
    assert!(queries["answered"].as_u64() >= Some(3), "{report}");
    assert!(queries["refused"]["UnknownRobot"].as_u64() >= Some(1), "{report}");

    let text = fs::read_to_string(fleet.config()).unwrap();
    let off = format!("{text}\n[queries]\nanswer = \"off\"\n");
    fs::write(fleet.config(), off).unwrap();
    let worker = fleet.worker();
    let silent = fleet.output("ask --robot 1 --idle 10 --through worker");
    assert_eq!(code(&silent), 1, "{silent:?}");
    assert!(stderr(&silent).contains("--through memory"), "{silent:?}");
    source.end(Signal::INT);
    assert_eq!(code(&worker.end(Signal::INT)), 0);
    assert!(fleet.stale_files().is_empty());
}

#[test]
fn a_robot_that_two_of_the_fleets_have_or_none_is_refused_before_a_worker_is_looked_for() {
    let fleet = fleet();
    let text = fs::read_to_string(fleet.config()).unwrap();
    let [other, same] = ["other.toml", "same.toml"].map(|name| fleet.path(name));
    let renamed = text.replace("name = \"cli\"", "name = \"other\"");
    assert_ne!(renamed, text);
    fs::write(&same, &renamed).unwrap();
    fs::write(&other, renamed.replace("[\"0-9\"]", "[\"70-79\"]")).unwrap();
    let both = "robot 3 is in the fleets other and cli: give each fleet ids of its own";
    let none = "none of the fleets other, cli has robot [999, 998]";
    for (robots, with, expected) in [
        ("--robot 3", &same, both),
        ("--rank 999,3", &same, both),
        ("--rank 999,998", &other, none),
    ] {
        let asked = fleet.output(&format!("ask {robots} --idle 5 --config {}", with.display()));
        assert_eq!(code(&asked), 2, "{asked:?}");
        assert!(stderr(&asked).contains(expected), "{asked:?}");
    }
}
