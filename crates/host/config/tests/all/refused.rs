//! Each mistake is refused or reported as a warning, with its line and a remedy.

use std::path::Path;

use joulebus_config::{CheckedFile, Config, ConfigError, File, KEYS, Problem, ValueKind};
use joulebus_settings::bounds::LEVEL_RATES;
use proptest::prelude::*;

/// A complete fleet in one text; each table below changes one line of it.
const WHOLE: &str = r#"[fleet]
name = "lab"
capacity = 100
[domain]
root = "/dev/shm/joulebus-{uid}"
prefix = "jb_"
[tick]
policy = "on_frame"
rate_hz = 30.0
deadline_ms = 10.0
[intake]
max_samples_per_tick = 8
max_jump_s = 60.0
leave_after_s = 30.0
[interval]
coverage = 0.9
[alarms]
noise_limit = 50.0
[ledger]
every_s = 1.0
[worker]
cpus = "1"
[[platform]]
robots = ["0-9", 20]
name = "one"
model = "persistence"
residual_std_w = 0.1
rate_hz = 30.0
stale_after_s = 0.5
hold_max_s = 0.5
stuck_after_s = 10.0
power_min_w = 0.0
power_max_w = 20.0
power_resolution_w = 0.01
v_max_mps = 0.2
omega_max_radps = 3.6
[platform.alarms]
noise_limit = 9.0
[platform.battery]
capacity_wh = 10.0
reserve = 0.1
initial_soc = 0.9
initial_soc_lo = 0.8
[[platform]]
file = "builtin:rover"
robots = ["30-39"]
"#;

fn parse(text: &str) -> Result<Config, ConfigError> {
    Config::parse(text, Path::new("/nowhere"))
}

/// The line, from 1, that contains `part`.
fn line_of(text: &str, part: &str) -> usize {
    let before = text.find(part).unwrap_or_else(|| panic!("no {part:?}"));
    1 + text[..before].matches('\n').count()
}

/// The only problem of the text.
fn problem(text: &str) -> Problem {
    match parse(text) {
        Ok(_) => panic!("accepted:\n{text}"),
        Err(refused) => {
            assert_eq!(refused.problems().len(), 1, "{refused}");
            refused.problems()[0].clone()
        }
    }
}

/// Replaces `from` by `to` in the complete text and checks the resulting problem.
fn assert_refused(from: &str, to: &str, key: &str, expected: &[&str]) {
    assert_eq!(WHOLE.matches(from).count(), 1, "{from:?} must occur once");
    let text = WHOLE.replace(from, to);
    let problem = problem(&text);
    assert_eq!(problem.key, key, "{problem}");
    assert_eq!(problem.line, Some(line_of(&text, to.trim_end())), "{problem}");
    assert!(!problem.remedy.is_empty(), "{problem}");
    for part in expected {
        assert!(problem.to_string().contains(part), "no {part:?} in: {problem}");
    }
}

/// Checks each case of a table: the replaced text, its replacement, the problem's key, its message.
fn each_case(table: &str, check: impl Fn(&str, &str, &str, &[&str])) {
    for case in joulebus_testkit::cases(table) {
        let case: Vec<&str> = case.iter().map(String::as_str).collect();
        let [from, to, key, expected @ ..] = case.as_slice() else {
            panic!("{case:?}");
        };
        check(from, to, key, expected);
    }
}

#[test]
fn of_many_problems_the_first_hundred_are_listed_and_long_texts_are_cut() {
    let many: String = (0..300_000).map(|key| format!("k{key} = 1\n")).collect();
    let long = "x".repeat(3 << 20);
    let platforms = "[[platform]]\nrobots = [\"a\"]\n".repeat(20_000);
    for (text, problems, named) in [
        (format!("{many}{WHOLE}"), 101, "there are more than 100 problems"),
        (format!("{long} = 1\n{WHOLE}"), 1, "is not a known key"),
        (format!("[{long}]\nkey = 1\n{WHOLE}"), 1, "is not a known section"),
        (WHOLE.replace("on_frame", &long), 1, "xxx…"),
        (WHOLE.replace("\"lab\"", &format!("\"/{long}\"")), 1, "xxx…"),
        (WHOLE.replace("= 10.0", &format!("= \"{long}\"")), 3, "xxx…"),
        (format!("{WHOLE}{platforms}"), 1, "is listed 20002 times, allowed are 256"),
    ] {
        let refused = parse(&text).unwrap_err();
        assert_eq!(refused.problems().len(), problems, "{named}");
        let shown = refused.to_string();
        assert!(shown.contains(named) && shown.len() < 20_000, "{named}");
    }
}

#[test]
fn the_complete_text_is_accepted() {
    let config = parse(WHOLE).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(config.warnings(), []);
    assert_eq!(config.settings().platforms[0].robots, [0..=9, 20..=20]);
    let battery = config.settings().platforms[0].battery.unwrap();
    assert_eq!(battery.capacity_j, 36_000.0);
}

#[test]
fn what_replaced_mixture_and_adapt_is_named() {
    for (line, key) in [
        ("adapt = \"on\"", "platform.adapt"),
        ("adapt = \"off\"", "platform.adapt"),
        ("forecast = \"mixture\"", "platform.forecast"),
    ] {
        let before = format!("{line}\nresidual_std_w = 0.1");
        assert_refused("residual_std_w = 0.1", &before, key, &["\"online\", the default"]);
    }
}

#[test]
fn what_went_from_files_of_bridges_and_links_is_refused_with_what_takes_its_place() {
    let writes = "[[mqtt.write]]\nwhat = \"budget\"\ntopic = \"b/{robot}\"\n";
    for (kind, text, instead) in [
        (File::Link, "[clock]\nrealtime_within_s = 0.001\n", "round trips"),
        (File::Bridge, "[mqtt.vizier]\nevery_s = 1\n", "vizier"),
        (File::Bridge, "[[mqtt.vda5050]]\ntopic = \"a\"\npass_on = \"b\"\n", "\"outlook\""),
        (File::Bridge, &format!("{writes}fields = {{ x = {{ value = \"soc\" }} }}\n"), "Node-RED"),
        (File::Bridge, "[[ros2.write]]\nwhat = \"value\"\nunit = \"%\"\n", "Node-RED"),
    ] {
        let file = CheckedFile::parse(text, Path::new("file.toml"), kind).unwrap();
        let mut remedies = file.problems.iter().map(|problem| &problem.remedy);
        assert!(remedies.any(|remedy| remedy.contains(instead)), "{text}: {:?}", file.problems);
    }
}

#[test]
fn a_key_of_a_webhook_that_is_gone_is_refused_with_what_takes_its_place() {
    for (line, instead) in [
        ("format = \"slack\"", "`text`"),
        ("template = '{}'", "--on-alarm"),
        ("repeat_s = 60", "configs/prometheus"),
    ] {
        let text = format!("[[webhook]]\naddress = \"http://host/\"\n{line}\n");
        let file = CheckedFile::parse(&text, Path::new("hooks.toml"), File::Webhooks).unwrap();
        let [problem] = file.problems.as_slice() else { panic!("{line}: {:?}", file.problems) };
        assert!(problem.remedy.contains(instead), "{line}: {problem}");
    }
}

#[test]
fn typos_are_refused_with_the_nearest_key() {
    let cases = r#"
        coverage = | coverge = | interval.coverge | `interval.coverage`
        max_jump_s = | max_jmup_s = | intake.max_jmup_s | `intake.max_jump_s` | 604800
        every_s = | every = | ledger.every | `ledger.every_s` | default 1
        hold_max_s = | max_hold_s = | platform.max_hold_s | `platform.hold_max_s`
        reserve = | resreve = | platform.battery.resreve | `platform.battery.reserve`
        v_max_mps = | mass_kg = | platform.mass_kg | no mechanics | `power_max_w` | config init --power
        v_max_mps = | max_speed_mps = | platform.max_speed_mps | `platform.v_max_mps`
        omega_max_radps = | max_turn_degps = | platform.max_turn_degps | `platform.omega_max_radps`
        reserve = | capacity_ah = | platform.battery.capacity_ah | `battery.capacity_wh` | nominal voltage
        [interval] | [intervall] | intervall | not a known section | `interval`
        noise_limit = | Noise_limit = | alarms.Noise_limit | `alarms.noise_limit`
        every_s = | zzzzzzzz = | ledger.zzzzzzzz | config explain
        every_s = | noise_limit = | ledger.noise_limit | `alarms.noise_limit`: move it there
    "#;
    each_case(cases, assert_refused_among);
}

/// Same as `assert_refused`, for a text that may occur elsewhere.
fn assert_refused_among(from: &str, to: &str, key: &str, expected: &[&str]) {
    let text = WHOLE.replacen(from, to, 1);
    assert_named(&text, key, line_of(WHOLE, from), expected);
}

/// Among the problems of the text is one of this key and line that states all of it.
fn assert_named(text: &str, key: &str, line: usize, expected: &[&str]) {
    let refused = parse(text).expect_err("accepted");
    let found = refused.problems().iter().find(|problem| problem.key == key);
    let found = found.unwrap_or_else(|| panic!("{refused}"));
    assert_eq!(found.line, Some(line), "{found}");
    for part in expected {
        assert!(found.to_string().contains(part), "no {part:?} in: {found}");
    }
}

#[test]
fn wrong_kinds_and_units_are_refused() {
    let cases = r#"
        deadline_ms = 10.0 | deadline_ms = "10ms" | tick.deadline_ms | "10ms" | 10 ms | without quotes
        stuck_after_s = 10.0 | stuck_after_s = "33ms" | platform.stuck_after_s | write 0.033 | The unit is always s
        cpus = "1" | cpus = "1,1" | worker.cpus | each once
        max_jump_s = 60.0 | max_jump_s = "1 min" | intake.max_jump_s | write 60
        power_max_w = 20.0 | power_max_w = "20" | platform.power_max_w | Write 20 without
        power_max_w = 20.0 | power_max_w = "20 s" | platform.power_max_w | Allowed: W
        max_jump_s = 60.0 | max_jump_s = 60000000 | intake.max_jump_s | meant in ms, write 60000 | 0.01 to 604800
        deadline_ms = 10.0 | deadline_ms = 0.01 | tick.deadline_ms | meant in s, write 10
        rate_hz = 30.0\ndeadline | rate_hz = 0.0333\ndeadline | tick.rate_hz | meant in s, write 30.03
        coverage = 0.9 | coverage = 90 | interval.coverage | meant in %, write 0.9
        coverage = 0.9 | coverage = nan | interval.coverage | NaN | 0.5 to 0.99
        power_max_w = 20.0 | power_max_w = inf | platform.power_max_w | inf
        power_min_w = 0.0 | power_min_w = -inf | platform.power_min_w | -inf
        capacity = 100 | capacity = 100.5 | fleet.capacity | float | whole number
        capacity = 100 | capacity = 0 | fleet.capacity | is 0 | 1 to 1000000
        capacity = 100 | capacity = true | fleet.capacity | boolean
        name = "lab" | name = "my lab" | fleet.name | letters, digits
        name = "lab" | name = 7 | fleet.name | integer
        prefix = "jb_" | prefix = "JB/" | domain.prefix | lower-case
        root = "/dev/shm/joulebus-{uid}" | root = "joulebus" | domain.root | absolute
        root = "/dev/shm/joulebus-{uid}" | root = "/dev/shm/../x" | domain.root | absolute
        root = "/dev/shm/joulebus-{uid}" | root = "/dev/shm/{user}" | domain.root | {uid}
        policy = "on_frame" | policy = "onframe" | tick.policy | nearest word is "on_frame"
        ["0-9", 20] | ["9-0"] | platform.robots | ends before it begins
        ["0-9", 20] | ["zero"] | platform.robots | "zero"
        ["0-9", 20] | [-1] | platform.robots | -1
        ["0-9", 20] | [4294967296] | platform.robots | 4294967296 | 4294967295
        ["0-9", 20] | "0-9" | platform.robots | string | list of ids
        ["0-9", 20] | [] | platform.robots | is empty
        model = "persistence" | model = "builtin:nothing" | platform.model | no such built-in model
        file = "builtin:rover" | file = "builtin:tank" | platform.file | gternal, robotino
        file = "builtin:rover" | file = "tank.toml" | platform.file | /nowhere/tank.toml
        file = "builtin:rover" | file = "/dev/zero" | platform.file | allowed are regular files
    "#;
    each_case(cases, assert_refused);
}

#[test]
fn a_key_in_another_unit_is_converted_in_the_remedy() {
    let cases = r#"
        deadline_ms = 10.0 | deadline_s = 0.01 | tick.deadline_s | `tick.deadline_ms` | 0.01 s is 10 ms
        stale_after_s = 0.5 | stale_after_ms = 500 | platform.stale_after_ms | `platform.stale_after_s` | 500 ms is 0.5 s
        hold_max_s = 0.5 | hold_max_ns = 500000000 | platform.hold_max_ns | is 0.5 s
        hold_max_s = 0.5 | period_ms = 40\nhold_max_s = 0.5 | platform.period_ms | `platform.rate_hz` | 40 ms is 25 Hz
    "#;
    each_case(cases, assert_refused);
}

#[test]
fn contradictions_are_refused_naming_both_keys_and_lines() {
    let cases = r#"
        cpus = "1" | threads = 3\ncpus = "1,4" | worker.threads | `worker.threads` = 3 threads (<config>:22) | more than the 2 CPUs of `worker.cpus` = "1,4" (<config>:23) | threads = 0
        deadline_ms = 10.0 | deadline_ms = 40 | tick.deadline_ms | `tick.deadline_ms` = 40.0 ms (<config>:10) | `tick.rate_hz` = 30.0 Hz (<config>:9)
        stale_after_s = 0.5 | stale_after_s = 0.06 | platform.stale_after_s | `stale_after_s` = 0.06 s (<config>:29) | `rate_hz` = 30.0 Hz (<config>:28) | 1.800
        leave_after_s = 30.0 | leave_after_s = 0.2 | intake.leave_after_s | `stale_after_s` = 0.5 s
        max_jump_s = 60.0 | max_jump_s = 0.3 | intake.max_jump_s | `stale_after_s` = 0.5 s
        hold_max_s = 0.5 | hold_max_s = 0.02 | platform.hold_max_s | `rate_hz` = 30.0 Hz
        stuck_after_s = 10.0 | stuck_after_s = 0.3 | platform.stuck_after_s | `hold_max_s` = 0.5 s
        power_min_w = 0.0 | power_min_w = 20 | platform.power_min_w | `power_min_w` = 20.0 W (<config>:32) | `power_max_w` = 20.0 W (<config>:33)
        power_resolution_w = 0.01 | power_resolution_w = 25 | platform.power_resolution_w | `power_max_w` = 20.0 W
        initial_soc_lo = 0.8 | initial_soc_lo = 0.95 | platform.battery.initial_soc_lo | `battery.initial_soc_lo` = 0.95 | `battery.initial_soc` = 0.9
        reserve = 0.1 | reserve = 0.9 | platform.battery.reserve | `battery.initial_soc` = 0.9
        robots = ["30-39"] | robots = ["5-39"] | platform.robots | "0-9" (<config>:24) | "5-39" (<config>:46) | robot 5
        ["0-9", 20] | ["0-9", "0-25", 20] | platform.robots | share robot 0
    "#;
    each_case(cases, |from, to, key, expected| {
        let text = WHOLE.replace(from, to);
        assert_named(&text, key, line_of(&text, to), expected);
    });
    let fast = WHOLE.replace("rate_hz = 30.0\nstale", "rate_hz = 300.0\nstale");
    assert!(problem(&fast).what.contains("`intake.max_samples_per_tick` = 8"));
    let twice = WHOLE.replace("name = \"one\"", "name = \"rover\"");
    assert!(problem(&twice).what.contains("<config>:23"), "{}", problem(&twice));
}

#[test]
fn keys_set_twice_are_refused_with_both_lines() {
    let cases = [
        ("capacity = 100\n", "capacity = 100\ncapacity = 100\n", 4, "in line 3"),
        ("[interval]\n", "[tick]\n[interval]\n", 15, "in line 7"),
    ];
    for (from, to, line, expected) in cases {
        let found = problem(&WHOLE.replacen(from, to, 1));
        assert_eq!(found.line, Some(line), "{found}");
        assert!(found.what.contains(expected), "{found}");
    }
}

#[test]
fn missing_keys_are_named() {
    for key in KEYS {
        if key.default != joulebus_config::DefaultValue::Required {
            continue;
        }
        let lines = WHOLE.lines().collect::<Vec<_>>();
        // The first line that sets the key in its own section.
        let section = match key.path.rsplit_once('.') {
            Some(("platform", _)) => "[[platform]]".to_owned(),
            Some((section, _)) => format!("[{section}]"),
            None => unreachable!("every key has a section"),
        };
        let start = lines.iter().position(|line| *line == section).unwrap();
        let offset =
            lines[start..].iter().position(|line| line.starts_with(&format!("{} =", key.name())));
        let mut lines = lines;
        lines.remove(start + offset.unwrap_or_else(|| panic!("{} is not set", key.path)));
        let refused = parse(&lines.join("\n")).expect_err(key.path);
        let missing = refused
            .problems()
            .iter()
            .find(|problem| problem.key == key.path && problem.what == "is missing");
        assert!(missing.is_some(), "{}: {refused}", key.path);
    }
    let bare = WHOLE.replace("residual_std_w = 0.1\n", "");
    assert!(problem(&bare).what.contains("residual_std_w"));
    let no_platform = "[fleet]\nname = \"lab\"\n";
    assert!(problem(no_platform).what.contains("no [[platform]]"));
    let single = "[fleet]\nname = \"lab\"\n[platform]\nname = \"one\"\n";
    assert!(problem(single).remedy.contains("[[platform]]"));
}

#[test]
fn all_errors_are_reported_at_once_in_order() {
    let text = WHOLE
        .replace("capacity = 100", "capactiy = 100")
        .replace("coverage = 0.9", "coverage = 2")
        .replace("v_max_mps = 0.2", "v_max_mps = \"fast\"")
        .replace("robots = [\"30-39\"]", "robots = [9]");
    let refused = parse(&text).unwrap_err();
    let keys: Vec<&str> = refused.problems().iter().map(|problem| problem.key.as_str()).collect();
    assert_eq!(
        keys,
        ["fleet.capactiy", "interval.coverage", "platform.v_max_mps", "platform.robots"]
    );
    assert_eq!(refused.to_string().lines().count(), 4);
}

#[test]
fn doubtful_values_are_accepted_with_a_warning() {
    for (from, to, key) in [
        ("capacity = 100", "capacity = 20", "fleet.capacity"),
        ("max_jump_s = 60.0", "max_jump_s = 20.0", "intake.max_jump_s"),
        ("cpus = \"1\"", "priority = 50", "worker.priority"),
        ("cpus = \"1\"", "if_refused = \"stop\"", "worker.if_refused"),
        ("noise_limit = 50.0", "cusum_limit = 50.0", "alarms.cusum_limit"),
        ("noise_limit = 50.0", "level_alarms_per_robot_h = 0.1", "alarms.level_alarms_per_robot_h"),
    ] {
        let config = parse(&WHOLE.replace(from, to)).unwrap_or_else(|error| panic!("{error}"));
        let keys: Vec<&str> =
            config.warnings().iter().map(|warning| warning.key.as_str()).collect();
        assert_eq!(keys, [key]);
    }
}

#[test]
fn a_rate_of_false_alarms_chooses_the_lowest_limit_that_keeps_it() {
    for (limit, per_robot_h) in LEVEL_RATES {
        let rate = format!("level_alarms_per_robot_h = {per_robot_h}");
        let text = WHOLE.replace("noise_limit = 50.0", &rate);
        let config = parse(&text).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(config.settings().alarms.level_limit, limit);
        assert_eq!(config.value("alarms.level_limit", 0), Some(&*format!("{limit:?}")));
        assert_eq!(config.warnings().len(), 1, "{:?}", config.warnings());
        let beside = text.replace(&rate, &format!("{rate}\nlevel_limit = 7.0"));
        let config_beside = parse(&beside).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(config_beside.settings().alarms.level_limit, limit);
        let keys: Vec<&str> = config_beside.warnings().iter().map(|one| &*one.key).collect();
        assert_eq!(keys, ["alarms.level_limit", "alarms.level_alarms_per_robot_h"]);
        // The first platform has limits, of which none is of levels. Both have 21 robots.
        let limits = config.settings().platforms[0].alarms.unwrap();
        assert_eq!(limits.level_limit, limit);
        let fleet = format!(
            "the 21 robots without a level_limit of their platform raise at most {:.3}",
            21.0 * per_robot_h
        );
        assert!(config.warnings()[0].what.contains(&fleet), "{:?}", config.warnings());
    }
}

#[test]
fn without_a_capacity_there_is_room_for_the_robots_that_are_listed_up_to_a_thousand() {
    let text = WHOLE.replace("capacity = 100\n", "");
    let room = |robots: &str| {
        let config = parse(&text.replace("robots = [\"30-39\"]", robots)).unwrap();
        (
            config.settings().capacity,
            config.warnings().iter().map(|warning| warning.key.clone()).collect(),
        )
    };
    let (few, none) = room("robots = [\"30-39\"]");
    assert_eq!(none, Vec::<String>::new());
    assert_eq!(room("robots = [\"30-49\"]"), (few + 10, none));
    assert_eq!(room("robots = [\"30-4999\"]"), (1_000, vec!["fleet.capacity".to_owned()]));
}

/// The complete text with one number replaced by `value`.
fn with_value(path: &str, value: f64) -> String {
    let (section, name) = path.rsplit_once('.').expect("a section");
    let header = match section {
        "platform" => "[[platform]]\n".to_owned(),
        section => format!("[{section}]\n"),
    };
    let start = WHOLE.find(&header).map_or(0, |start| start + header.len());
    let (before, after) = WHOLE.split_at(start);
    let end = after.find("\n[").map_or(after.len(), |end| end + 1);
    let (of_section, rest) = after.split_at(end);
    let kept: String = of_section
        .lines()
        .filter(|line| !line.starts_with(&format!("{name} =")))
        .map(|line| format!("{line}\n"))
        .collect();
    let header = if start == 0 { header } else { String::new() };
    format!("{before}{header}{name} = {value:?}\n{kept}{rest}")
}

#[test]
fn bounds_are_accepted_and_values_beyond_them_are_not() {
    for key in KEYS {
        let ValueKind::Number { min, max } = key.kind else {
            continue;
        };
        for (end, past) in [(min, min.next_down()), (max, max.next_up())] {
            let refused = |value: f64| match parse(&with_value(key.path, value)) {
                Ok(_) => None,
                Err(error) => Some(error.to_string()),
            };
            // The value may contradict other keys, but must not be out of range.
            if let Some(text) = refused(end) {
                assert!(
                    text.contains("contradicts") && !text.contains("out of its range"),
                    "{} = {end}: {text}",
                    key.path
                );
            }
            let text = refused(past).unwrap_or_else(|| panic!("{} = {past} is accepted", key.path));
            assert!(text.contains("out of its range"), "{}: {text}", key.path);
        }
    }
}

proptest! {
    #[test]
    fn no_text_causes_a_panic(text in any::<String>()) {
        let _ = parse(&text);
    }

    #[test]
    fn no_corruption_of_a_config_causes_a_panic_and_accepted_ones_pass_the_ticks_check(
        at in 0..WHOLE.len(),
        length in 0_usize..40,
        piece in "[-a-z0-9.=\"\\[\\]_\n{} ]{0,12}",
    ) {
        let end = (at + length).min(WHOLE.len());
        let text = format!("{}{piece}{}", &WHOLE[..at], &WHOLE[end..]);
        match parse(&text) {
            Ok(config) => {
                prop_assert_eq!(config.settings().check(), Ok(()));
                let again = parse(config.to_toml());
                prop_assert!(again.is_ok(), "{}", again.unwrap_err());
                let again = again.unwrap();
                prop_assert_eq!(again.settings(), config.settings());
            }
            Err(refused) => prop_assert!(!refused.problems().is_empty()),
        }
    }

    #[test]
    fn no_number_causes_a_panic_or_escapes_its_range(
        index in 0..KEYS.len(),
        value in any::<f64>(),
    ) {
        let key = &KEYS[index];
        let ValueKind::Number { min, max } = key.kind else { return Ok(()) };
        match parse(&with_value(key.path, value)) {
            Ok(config) => {
                prop_assert!(min <= value && value <= max);
                prop_assert_eq!(config.settings().check(), Ok(()));
            }
            Err(refused) => {
                let out_of_range = refused.to_string().contains("out of its range");
                prop_assert_eq!(out_of_range, !(min <= value && value <= max), "{}", refused);
            }
        }
    }
}

#[test]
fn text_that_is_nested_too_deep_is_refused_with_its_line() {
    let deep = |separator: &str| vec!["a"; 300].join(separator);
    for line in [
        format!("{} = 1", deep(".")),
        format!("tick.{} = 1", deep(".")),
        format!("[{}]", deep(".")),
        format!("[[{}]]", deep(".")),
        format!("x = {}1{}", "[".repeat(300), "]".repeat(300)),
        format!("x = {}1{}", "{a = ".repeat(300), "}".repeat(300)),
    ] {
        let text = format!("[fleet]\nname = \"x\"\n\n# ä\n{line}\n[tick]\nrate_hz = 30\n");
        let refused = Config::parse(&text, Path::new("/nowhere")).unwrap_err();
        let problem = &refused.problems()[0];
        let shown: String = line.chars().take(20).collect();
        assert_eq!(problem.line, Some(5), "{shown}: {problem}");
    }
}
