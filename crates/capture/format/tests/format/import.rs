//! Import of other programs' recordings: used and refused messages, with reasons.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::Cursor;

use crate::bag::{BATTERY, Bag, battery, header, odometry, twist};
use byteorder::{BigEndian, LittleEndian};
use cdr_encoding::to_vec;
use joulebus_capture_format::import::{Mapping, RobotReport, import};
use joulebus_ros_messages::{BatteryState, TwistStamped};
use joulebus_testkit::assert_contains;
use joulebus_testkit::recordings::shared;

#[test]
fn a_real_recording_becomes_rows_and_everything_else_is_counted() {
    let Some(folder) = shared("mcap/couguv") else {
        return;
    };
    let file = folder.join("SO_lastbag_mcap_0.mcap");
    let mapping: Mapping = "current = \"discharge-positive\"".parse().unwrap();
    let imported = import(File::open(&file).unwrap(), "couguv", &mapping).unwrap();
    assert_eq!(imported.robots.len(), 1);
    let robot = &imported.robots[0];
    assert_eq!((robot.name.as_str(), robot.time), ("coug2", "log"));
    assert_eq!(robot.battery.messages, 2628);
    assert!(robot.battery.refused.is_empty());
    // Ten bursts per second for 119.5 s.
    assert_eq!(robot.row_count, robot.rows.len() as u64);
    assert_eq!(robot.row_count + robot.merged_in_bursts, 2628);
    let count = robot.row_count;
    assert!((1190..=1200).contains(&count), "{count}");
    let times: Vec<u64> = robot.rows.iter().map(|row| row.time_ns).collect();
    assert!(times.is_sorted_by(|before, after| before < after));
    for row in &robot.rows {
        assert!(row.power_w > 0.0 && row.v_mps.is_nan() && row.omega_radps.is_nan());
        assert!(row.x_m.is_nan());
    }
    assert!(robot.command.is_none());
    let odometry = robot.odometry.as_ref().unwrap();
    assert_eq!(odometry.topic, "/coug2/odom");
    let not_numbers: u64 = odometry.refused.values().sum();
    assert!(not_numbers > 0, "{odometry:?}");
    let notes = robot.notes.join("\n");
    let parts = ["2628 of 2628 readings have no stamp", "`present` is false"];
    assert_contains(&notes, parts);
    assert!(!notes.contains("flowing into the battery"), "{notes}");
    assert_eq!(imported.unusable.len(), 1, "{:?}", imported.unusable);
    let others: u64 = imported.others.values().sum();
    let used = robot.battery.messages + odometry.messages + imported.unusable[0].messages;
    assert_eq!(others + used, 18_558);
    let (readings, merged) = (robot.battery.messages, robot.merged_in_bursts);
    println!(
        "figure: couguv: {count} rows of {readings} readings, {merged} merged in bursts, {others} messages of {} other types",
        imported.others.len()
    );
}

#[test]
fn a_current_of_the_wrong_sign_is_reported() {
    let Some(folder) = shared("mcap/couguv") else {
        return;
    };
    let file = folder.join("SO_lastbag_mcap_0.mcap");
    let imported = import(File::open(&file).unwrap(), "couguv", &Mapping::default()).unwrap();
    let robot = &imported.robots[0];
    assert!(robot.rows.iter().all(|row| row.power_w < 0.0));
    let part = "check whether it is discharge-positive";
    assert_contains(&robot.notes.join("\n"), [part]);
    // Stamps of 0 are unset.
    let mapping: Mapping = "time = \"header\"".parse().unwrap();
    let imported = import(File::open(&file).unwrap(), "couguv", &mapping).unwrap();
    let robot = &imported.robots[0];
    assert_eq!(robot.row_count, 0);
    assert_eq!(robot.battery.refused["its header has no stamp"], 2628);
    assert!(!imported.is_whole());
}

#[test]
fn corner_cases_of_rosbag2_are_reported_as_without_battery() {
    let Some(folder) = shared("mcap/rosbag2") else {
        return;
    };
    let mut files = 0;
    for file in fs::read_dir(folder).unwrap() {
        let file = file.unwrap().path();
        let imported = import(File::open(&file).unwrap(), "x", &Mapping::default()).unwrap();
        assert!(imported.robots.is_empty(), "{file:?}");
        assert!(imported.damage.is_empty(), "{file:?}");
        assert!(imported.others.values().sum::<u64>() > 0, "{file:?}");
        files += 1;
        let mapping = "[[robot]]\nname = \"r\"\nbattery = \"/test_topic\"";
        let mapping: Mapping = mapping.parse().unwrap();
        let refused = import(File::open(&file).unwrap(), "x", &mapping).unwrap_err();
        assert_contains(&refused, ["/test_topic"]);
    }
    assert_eq!(files, 20);
}

const TENTH_NS: u64 = 100_000_000;
const START_NS: u64 = 1_700_000_000_000_000_000;

#[test]
fn readings_commands_and_odometry_are_joined_in_time() {
    let mut bag = Bag::new();
    bag.channel("/r/battery", "sensor_msgs/msg/BatteryState", "cdr", BATTERY);
    bag.channel("/r/cmd_vel", "geometry_msgs/msg/TwistStamped", "cdr", "");
    bag.channel("/r/odom", "nav_msgs/msg/Odometry", "cdr", "");
    for step in 0..20_u64 {
        let now_ns = START_NS + step * TENTH_NS;
        // Recorded late and out of order; the headers have the right times.
        let late_ns = now_ns + 7_000_000 * (step % 3);
        let reading = battery(now_ns, 12.0, -0.5 - step as f32);
        bag.message("/r/battery", late_ns, &reading);
        if step >= 5 {
            let stamped =
                TwistStamped { header: header(now_ns - 1), twist: twist(step as f64, -1.0) };
            bag.message("/r/cmd_vel", late_ns, &stamped);
        }
        if step == 3 {
            bag.message("/r/odom", late_ns, &odometry(now_ns, 1.5, 0.5, 0.3));
        }
    }
    let imported = bag.import("odometry_max_age_s = 0.35").unwrap();
    assert!(imported.is_whole(), "{imported}");
    let robot = &imported.robots[0];
    assert_eq!((robot.time, robot.row_count), ("header", 20));
    assert_eq!(robot.name, "r");
    for (step, row) in robot.rows.iter().enumerate() {
        assert_eq!(row.time_ns, START_NS + step as u64 * TENTH_NS);
        // Negative while discharging, as in ROS: the power drawn is positive.
        assert_eq!(row.power_w, 12.0 * (0.5 + step as f64));
        if step < 5 {
            assert!(row.v_mps.is_nan() && row.omega_radps.is_nan());
        } else {
            assert_eq!((row.v_mps, row.omega_radps), (step as f64, -1.0));
        }
        if (3..=6).contains(&step) {
            assert_eq!((row.x_m, row.y_m, row.v_measured_mps), (1.5, 3.0, 0.3));
            assert!((row.theta_rad - 0.5).abs() < 1e-12);
        } else {
            assert!(row.x_m.is_nan(), "{step}: {row:?}");
            assert!(row.v_measured_mps.is_nan(), "{step}: {row:?}");
        }
    }
}

#[test]
fn undecodable_messages_are_refused_by_reason_and_the_rest_is_used() {
    let mut bag = Bag::new();
    bag.channel("/battery", "sensor_msgs/BatteryState", "cdr", BATTERY);
    for step in 0..10_u64 {
        let now_ns = START_NS + step * TENTH_NS;
        bag.message("/battery", now_ns, &battery(now_ns, 10.0, -1.5));
    }
    let at = |tenth| START_NS + tenth * TENTH_NS;
    let mut whole = vec![0, 0, 0, 0];
    whole.extend(to_vec::<_, BigEndian>(&battery(at(20), 11.0, -2.0)).unwrap());
    bag.raw("/battery", at(20), &whole);
    bag.message("/battery", at(21), &battery(1, f32::NAN, -1.5));
    for cut in 0..whole.len() {
        bag.raw("/battery", at(30), &whole[..cut]);
    }
    let mut other = whole.clone();
    other[1] = 7;
    bag.raw("/battery", at(31), &other);
    whole.extend([0; 9]);
    bag.raw("/battery", at(32), &whole);
    let messages = 10 + 2 + (whole.len() as u64 - 9) + 2;
    let imported = bag.import("").unwrap();
    let robot = &imported.robots[0];
    let found = &robot.battery;
    assert_eq!((found.messages, robot.row_count), (messages, 11));
    assert_eq!(robot.name, "bag");
    assert_eq!(robot.rows[10].power_w, 22.0);
    // A string may lack its terminating zero and there may be up to three bytes of padding: nothing
    // else is tolerated.
    let refused: u64 = found.refused.values().sum();
    let accounted = refused + robot.row_count + robot.merged_in_bursts;
    assert_eq!(accounted, messages, "{found:?}");
    assert!(!imported.is_whole());
    let reasons: Vec<&str> = found.refused.keys().map(|why| &**why).collect();
    let parts = ["Plain CDR begins with", "not a number", "9 bytes follow"];
    assert_contains(&reasons.join("\n"), parts);
}

/// Found by fuzzing: a topic may have channels of several kinds.
#[test]
fn messages_of_another_kind_on_a_topic_are_refused_and_counted() {
    let mut bag = Bag::new();
    bag.channel("/r/battery", "sensor_msgs/msg/BatteryState", "cdr", BATTERY);
    for step in 0..3_u64 {
        let now_ns = START_NS + step * TENTH_NS;
        bag.message("/r/battery", now_ns, &battery(now_ns, 12.0, -1.5));
    }
    bag.channel("/r/battery", "geometry_msgs/msg/Twist", "cdr", "");
    bag.message("/r/battery", START_NS + 3 * TENTH_NS, &twist(1.0, 1.0));
    let mapping = "[[robot]]\nname = \"r\"\nbattery = \"/r/battery\"";
    let imported = bag.import(mapping).unwrap();
    let robot = &imported.robots[0];
    assert_eq!((robot.battery.messages, robot.row_count), (4, 3));
    assert_eq!(robot.battery.refused["of a channel of Twist messages"], 1);
    assert!(robot.rows.iter().all(|row| row.v_mps.is_nan()));
}

#[test]
fn a_type_with_other_fields_or_another_encoding_is_not_misread() {
    let mut bag = Bag::new();
    let older = BATTERY.replace("float32 temperature\n", "");
    let state = "sensor_msgs/msg/BatteryState";
    bag.channel("/old/battery", state, "cdr", &older);
    bag.channel("/odd/battery", state, "wrong_format", BATTERY);
    bag.message("/old/battery", START_NS, &1_u32);
    bag.message("/odd/battery", START_NS, &1_u32);
    let imported = bag.import("").unwrap();
    assert!(imported.robots.is_empty());
    let unusable = imported.unusable.iter();
    let why: Vec<&str> = unusable.map(|channel| channel.why.as_str()).collect();
    assert_eq!(why.len(), 2, "{why:?}");
    assert_contains(&why.join("\n"), ["float32 temperature", "wrong_format"]);
}

#[test]
fn two_robots_of_one_file_are_distinguished_by_namespace_or_mapping() {
    let bag = || {
        let mut bag = Bag::new();
        for robot in ["a", "b"] {
            let (state, command) = (format!("/{robot}/battery"), format!("/{robot}/cmd_vel"));
            bag.channel(&state, "sensor_msgs/msg/BatteryState", "cdr", BATTERY);
            bag.channel(&command, "geometry_msgs/msg/Twist", "cdr", "");
        }
        for step in 0..5_u64 {
            let now_ns = START_NS + step * TENTH_NS;
            for (robot, v_mps) in [("a", 1.0), ("b", 2.0)] {
                bag.message(&format!("/{robot}/cmd_vel"), now_ns, &twist(v_mps, 0.0));
                let reading = battery(now_ns, 10_000.0, 500.0);
                bag.message(&format!("/{robot}/battery"), now_ns, &reading);
            }
        }
        bag
    };
    let imported = bag().import("").unwrap();
    let robots = imported.robots.iter();
    let found: Vec<_> = robots.map(|robot| (robot.name.as_str(), robot.rows[2].v_mps)).collect();
    assert_eq!(found, [("a", 1.0), ("b", 2.0)]);
    let mapping = "time = \"log\"\n[[robot]]\nname = \"second\"\nid = 9\nbattery = \"/b/battery\"\n\
        command = \"/a/cmd_vel\"\ncurrent = \"discharge-positive\"\nvoltage_unit_v = 0.001\ncurrent_unit_a = 0.001";
    let imported = bag().import(mapping).unwrap();
    let robot = &imported.robots[0];
    assert_eq!((robot.id, robot.time), (Some(9), "log"));
    assert_eq!(robot.name, "second");
    assert_eq!((robot.rows[0].v_mps, robot.rows[0].power_w), (1.0, 5.0));
    assert_eq!(imported.unusable.len(), 2, "{:?}", imported.unusable);
    let twice = format!("{mapping}\n[[robot]]\nname = \"second\"\nbattery = \"/a/battery\"");
    assert_contains(&bag().import(&twice).unwrap_err(), ["second"]);
}

/// A bag in which each battery, command and odometry has five messages, the n-th topic with v = n.
fn bag_of(batteries: &[&str], commands: &[&str]) -> Bag {
    let mut bag = Bag::new();
    for topic in batteries {
        bag.channel(topic, "sensor_msgs/msg/BatteryState", "cdr", BATTERY);
    }
    for topic in commands {
        bag.channel(topic, "geometry_msgs/msg/Twist", "cdr", "");
    }
    for step in 0..5_u64 {
        let now_ns = START_NS + step * TENTH_NS;
        for (topic, v_mps) in commands.iter().zip(1..) {
            bag.message(topic, now_ns, &twist(f64::from(v_mps), 0.0));
        }
        for topic in batteries {
            bag.message(topic, now_ns, &battery(now_ns, 10.0, -0.5));
        }
    }
    bag
}

#[test]
fn a_battery_goes_with_the_topics_of_its_longest_namespace() {
    let deep = ["/fleet/r1/battery_state", "/fleet/r2/battery_state", "/fleet/r3/battery_state"];
    let imported = bag_of(&deep, &["/fleet/r1/cmd_vel", "/fleet/r2/cmd_vel"]).import("").unwrap();
    let of = |robot: &RobotReport| (robot.name.clone(), robot.rows[2].v_mps);
    let found: Vec<_> = imported.robots.iter().map(of).collect();
    assert_eq!(found[..2], [("r1".to_owned(), 1.0), ("r2".to_owned(), 2.0)]);
    assert_eq!(found[2].0, "r3");
    assert!(found[2].1.is_nan(), "the command of another robot: {found:?}");

    // Several batteries of one robot: one is chosen, with the robot's command.
    let several = ["/p/battery/status", "/p/battery/left/status", "/p/battery/right/status"];
    let bag = || bag_of(&several, &["/p/cmd_vel", "/q/cmd_vel"]);
    let refused = bag().import("").unwrap_err().to_string();
    assert_contains(&refused, several.iter().chain(&["`packs`", "mapping file (--mapping)"]));
    let mut mapping: Mapping =
        "[[robot]]\nname = \"p\"\nbattery = \"/p/battery/left/status\"".parse().unwrap();
    let chosen = |mapping: &Mapping| import(Cursor::new(bag().bytes()), "bag", mapping).unwrap();
    assert!(chosen(&mapping).robots[0].rows[2].v_mps.is_nan(), "a mapping says all");
    mapping.robots[0].is_searched = true;
    assert_eq!(chosen(&mapping).robots[0].rows[2].v_mps, 1.0);
}

#[test]
fn a_battery_alone_goes_with_its_own_robot() {
    let velocity = |commands: &[&str]| {
        let imported = bag_of(&["/r1/battery"], commands).import("").unwrap();
        let unusable: Vec<_> = imported.unusable.iter().map(|one| one.topic.clone()).collect();
        (imported.robots[0].rows[2].v_mps, unusable)
    };
    let r2 = "/r2/cmd_vel";
    assert_eq!(velocity(&["/r1/cmd_vel", r2]), (1.0, vec![r2.to_owned()]));
    assert_eq!(velocity(&[r2, "/cmd_vel"]), (2.0, vec![r2.to_owned()]));
    let (foreign, unusable) = velocity(&[r2]);
    assert!(foreign.is_nan(), "{foreign}");
    assert_eq!(unusable, [r2]);
    // Parts of one robot.
    assert_eq!(velocity(&["/base_controller/cmd_vel"]), (1.0, Vec::new()));
}

#[test]
fn robots_of_one_namespace_beside_another_get_names_of_their_own() {
    let batteries = ["/fleet/r1/battery", "/fleet/r2/battery", "/dock/battery"];
    let imported = bag_of(&batteries, &[]).import("").unwrap();
    let names: Vec<_> = imported.robots.iter().map(|one| &*one.name).collect();
    assert_eq!(names, ["r1", "r2", "dock"]);
    for (battery, commands, name) in [
        ("/fleet/r1/battery_state", &["/fleet/r1/cmd_vel"][..], "r1"),
        ("/fleet/r1/battery_state", &["/fleet/r1/cmd_vel", "/fleet/r2/cmd_vel"], "r1"),
        ("/fleet/r1/battery_state", &[], "r1"),
        ("/fleet/alice/battery_state", &["/fleet/alice/cmd_vel"], "alice"),
        ("/site/fleet/r1/power/battery", &["/site/fleet/r1/cmd_vel"], "r1"),
        ("/r1/base/battery", &["/r1/base/cmd_vel"], "r1"),
        ("/panther/battery/battery_status", &["/panther/cmd_vel"], "panther"),
        ("/panther/battery/battery_status", &[], "panther"),
        ("/battery/state", &["/cmd_vel"], "battery"),
        ("/battery_state", &["/cmd_vel"], "bag"),
    ] {
        let imported = bag_of(&[battery], commands).import("").unwrap();
        assert_eq!(imported.robots[0].name, name, "{battery} {commands:?}");
    }
}

#[test]
fn channels_of_one_topic_in_one_file_are_one() {
    let mut bag = Bag::new();
    let state = "sensor_msgs/msg/BatteryState";
    for (restarts, step) in [("0", 0_u64), ("1", 5)] {
        let metadata = BTreeMap::from([("restarts".to_owned(), restarts.to_owned())]);
        bag.channel_with("/r/battery", state, "cdr", BATTERY, &metadata);
        for step in step..step + 5 {
            let now_ns = START_NS + step * TENTH_NS;
            bag.message("/r/battery", now_ns, &battery(now_ns, 10.0, -0.5));
        }
    }
    let imported = bag.import("").unwrap();
    let robots: Vec<_> =
        imported.robots.iter().map(|robot| (robot.name.as_str(), robot.row_count)).collect();
    assert_eq!(robots, [("r", 10)]);
    assert!(imported.is_whole());
}

#[test]
fn messages_that_rosbag2_compressed_are_read() {
    let mut bag = Bag::new();
    bag.channel("/r/battery", "sensor_msgs/msg/BatteryState", "cdr", BATTERY);
    for step in 0..5_u64 {
        let now_ns = START_NS + step * TENTH_NS;
        let mut data = vec![0, 1, 0, 0];
        data.extend(to_vec::<_, LittleEndian>(&battery(now_ns, 10.0, -0.5)).unwrap());
        bag.raw("/r/battery", now_ns, &zstd::bulk::compress(&data, 3).unwrap());
    }
    // A bomb is refused, as what it is not.
    let bomb = zstd::bulk::compress(&vec![0; 80 << 20], 19).unwrap();
    bag.raw("/r/battery", START_NS + 5 * TENTH_NS, &bomb);
    let imported = bag.import("").unwrap();
    let robot = &imported.robots[0];
    assert_eq!((robot.row_count, robot.battery.messages), (5, 6));
    assert_eq!(robot.rows[4].power_w, 5.0);
    assert_eq!(robot.battery.refused.values().sum::<u64>(), 1);
}

#[test]
fn a_file_of_another_kind_is_named() {
    for (bytes, part) in [
        (&b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n"[..], "git lfs pull"),
        (b"#ROSBAG V2.0\n", "rosbags-convert"),
        (b"", "an empty file"),
        (b"hello, world", "68, 65"),
    ] {
        let refused = import(Cursor::new(bytes), "bag", &Mapping::default()).unwrap_err();
        assert_contains(&refused, [part, "an MCAP file begins with"]);
    }
}

#[test]
fn an_invalid_mapping_is_refused() {
    let unit = "[[robot]]\nname = \"r\"\nbattery = \"b\"\nvoltage_unit_v = 0.0";
    for (text, part) in [
        ("tme = \"log\"", "tme"),
        ("time = \"wall\"", "wall"),
        ("burst_s = -1.0", "burst_s"),
        ("burst_s = nan", "burst_s"),
        ("[[robot]]\nname = \"r\"", "battery"),
        (unit, "voltage_unit_v"),
    ] {
        assert_contains(&text.parse::<Mapping>().unwrap_err(), [part]);
    }
}

/// Readings with stamps that lie `ahead_s` before the time of recording, 0 for none; commands of
/// 0.2 m/s in the first half, then 0, every 100 ms.
fn two_clocks(stamp: impl Fn(u64) -> u64, stamped: Option<u64>) -> Bag {
    let mut bag = Bag::new();
    bag.channel("/battery", "sensor_msgs/msg/BatteryState", "cdr", BATTERY);
    let kind = match stamped {
        None => "geometry_msgs/msg/Twist",
        Some(_) => "geometry_msgs/msg/TwistStamped",
    };
    bag.channel("/cmd_vel", kind, "cdr", "");
    for step in 0..60_u64 {
        let now_ns = START_NS + step * TENTH_NS;
        let twist = twist(if step < 30 { 0.2 } else { 0.0 }, 0.0);
        match stamped {
            None => bag.message("/cmd_vel", now_ns, &twist),
            Some(ahead_ns) => {
                let stamp_ns = now_ns.checked_add(ahead_ns).unwrap_or(0);
                let header = header(stamp_ns);
                bag.message("/cmd_vel", now_ns, &TwistStamped { header, twist });
            }
        }
        bag.message("/battery", now_ns + 1_000_000, &battery(stamp(now_ns), 12.0, -1.5));
    }
    bag
}

#[test]
fn stamps_are_not_joined_with_times_of_another_clock() {
    type Stamp = fn(u64) -> u64;
    const SECOND_NS: u64 = 1_000_000_000;
    const LATE_NS: u64 = 90 * SECOND_NS;
    let cases: [(Stamp, Option<u64>, &str, &str); 9] = [
        (|ns| ns, None, "header", "commands without a stamp use"),
        (|ns| ns, Some(u64::MAX), "header", "without a stamp use"),
        (|ns| ns - START_NS + 12 * SECOND_NS, None, "log", "s behind"),
        (|ns| ns + LATE_NS, None, "log", "90.00 s ahead of"),
        (|ns| ns - 2 * SECOND_NS, None, "log", "2.00 s behind"),
        (|ns| ns + (ns - START_NS) / 10, None, "log", "drift by"),
        (|ns| ns / SECOND_NS * SECOND_NS, None, "log", "whole seconds"),
        (|_| START_NS, None, "log", "stand still"),
        // All have the robot's clock.
        (|ns| ns + LATE_NS, Some(LATE_NS), "header", ""),
    ];
    for (number, (stamp, stamped, clock, expected_note)) in cases.into_iter().enumerate() {
        let name = format!("case {number}, {expected_note}");
        let imported = two_clocks(stamp, stamped).import("").unwrap();
        let robot = &imported.robots[0];
        let notes = robot.notes.join("\n");
        assert!(imported.is_whole(), "{name}: {imported}");
        assert!(notes.contains(expected_note), "{name}: {imported}");
        assert_eq!((robot.time, robot.row_count), (clock, 60), "{name}");
        for (step, row) in robot.rows.iter().enumerate() {
            let v_mps = if step < 30 { 0.2 } else { 0.0 };
            assert_eq!(row.v_mps, v_mps, "{name}: row {step}");
        }
    }
}

#[test]
fn a_recorder_whose_clock_is_set_back_begins_another_trial() {
    let mut bag = Bag::new();
    bag.channel("/battery", "sensor_msgs/msg/BatteryState", "cdr", BATTERY);
    for step in 0..60_u64 {
        let back_ns = if step < 40 { 0 } else { 30 * TENTH_NS };
        let now_ns = START_NS + step * TENTH_NS - back_ns;
        bag.message("/battery", now_ns, &battery(0, 12.0, -1.0 - step as f32));
    }
    let imported = bag.import("").unwrap();
    let robot = &imported.robots[0];
    assert_eq!(robot.row_count, 60, "{imported}");
    assert_eq!(robot.runs_from, [40], "{imported}");
    assert_contains(&robot.notes.join("\n"), ["set back 1 times"]);
    for (step, row) in robot.rows.iter().enumerate() {
        assert_eq!(row.power_w, 12.0 * (1.0 + step as f64));
    }
}

/// A remote control that falls silent.
#[test]
fn a_command_expires_as_in_the_bridge() {
    let bag = || {
        let mut bag = Bag::new();
        bag.channel("/battery", "sensor_msgs/msg/BatteryState", "cdr", BATTERY);
        bag.channel("/cmd_vel", "geometry_msgs/msg/Twist", "cdr", "");
        for step in 0..60_u64 {
            let now_ns = START_NS + step * TENTH_NS;
            if (10..20).contains(&step) {
                bag.message("/cmd_vel", now_ns, &twist(0.5, 0.0));
            }
            bag.message("/battery", now_ns, &battery(now_ns, 12.0, -1.5));
        }
        bag
    };
    for (mapping, last, after) in [
        ("", 24, f64::NAN),
        ("command_expired = \"stops\"", 24, 0.0),
        ("command_holds_s = 2", 39, f64::NAN),
        ("command_holds_s = 3600", 59, f64::NAN),
    ] {
        let imported = bag().import(mapping).unwrap();
        let robot = &imported.robots[0];
        for (step, row) in robot.rows.iter().enumerate() {
            let expected = match step {
                ..10 => f64::NAN,
                _ if step <= last => 0.5,
                _ => after,
            };
            let [found, expected] = [row.v_mps, expected].map(f64::to_bits);
            assert_eq!(found, expected, "{mapping}: row {step}");
        }
        let notes = robot.notes.join("\n");
        let counted = format!("{} of 60 rows", 59 - last);
        assert_eq!(notes.contains(&counted), last < 59, "{mapping}: {notes}");
    }
}

/// One unit for all readings: 1 % is not full.
#[test]
fn percentages_are_read_as_such_in_all_readings() {
    let imported = |charge: &dyn Fn(u64) -> f32| {
        let mut bag = Bag::new();
        bag.channel("/battery", "sensor_msgs/msg/BatteryState", "cdr", BATTERY);
        for step in 0..60_u64 {
            let now_ns = START_NS + step * TENTH_NS;
            let mut state = battery(now_ns, 12.0, -1.5);
            state.percentage = charge(step);
            bag.message("/battery", now_ns, &state);
        }
        bag.import("").unwrap().robots.remove(0)
    };
    let percent = imported(&|step| 60.0 - step as f32);
    assert_eq!(percent.rows[0].soc, 0.6);
    assert!((percent.rows[59].soc - 0.01).abs() < 1e-9);
    assert_contains(&percent.notes.join("\n"), ["0 to 100"]);
    let share = imported(&|step| if step == 7 { 7.0 } else { 0.5 });
    assert!(share.rows[7].soc.is_nan() && share.rows[8].soc == 0.5);
    assert_contains(
        &share.notes.join("\n"),
        ["1 of 60 readings have a percentage outside", "left out"],
    );
    // The last one is that of mavros. Drivers that measure nothing else leave it at 0.
    for unknown in [-1.0, f32::NAN, -0.01] {
        for (known, expected) in [(0.5, 0.5), (60.0, 0.6), (0.0, f64::NAN)] {
            let robot = imported(&|step| [unknown, known][usize::from(step % 2 == 0)]);
            assert_eq!((robot.row_count, robot.battery.refused.len()), (60, 0));
            let [even, odd] = [robot.rows[8].soc, robot.rows[7].soc];
            assert!(odd.is_nan() && even.total_cmp(&expected).is_eq(), "{unknown} {known}: {even}");
            assert_contains(
                &robot.notes.join("\n"),
                ["30 of 60 readings have a percentage of NaN or −1"],
            );
        }
    }
}

/// A table of what drivers say: the readings, and whether each has a power and a current.
#[test]
fn what_is_charged_or_not_measured_is_no_power() {
    let imported = |current: &dyn Fn(u64) -> f32, status: &dyn Fn(u64) -> u8| {
        let mut bag = Bag::new();
        bag.channel("/r/battery", "sensor_msgs/msg/BatteryState", "cdr", BATTERY);
        for step in 0..60_u64 {
            let now_ns = START_NS + step * TENTH_NS;
            let mut state = battery(now_ns, 24.0, current(step));
            state.power_supply_status = status(step);
            bag.message("/r/battery", now_ns, &state);
        }
        bag.import("").unwrap().robots.remove(0)
    };
    let known = |robot: &RobotReport| {
        let power = robot.rows.iter().filter(|row| row.power_w.is_finite()).count();
        (power, robot.rows.iter().filter(|row| row.current_a.is_finite()).count())
    };
    // A dock in the second half, with a status that says so or does not.
    let dock = |step: u64| if step < 30 { -0.4 } else { 2.9 };
    for (on_the_dock, expected) in [(0, 60), (1, 30), (2, 60), (3, 60), (4, 30), (9, 60)] {
        let robot = imported(&dock, &|step| if step < 30 { 2 } else { on_the_dock });
        assert_eq!(known(&robot), (expected, 60), "status {on_the_dock}");
        let notes = robot.notes.join("\n");
        assert_eq!(
            notes.contains("30 of 60 readings are on the charger"),
            expected < 60,
            "{notes}"
        );
        assert!(robot.rows[..30].iter().all(|row| row.power_w > 0.0));
    }
    // A discharge that has the wrong sign is none of a charger.
    let robot = imported(&|_| -2.5, &|_| 1);
    assert_eq!(known(&robot), (0, 60));
    for (current, expected, why) in [
        (&(|_: u64| -1.0_f32) as &dyn Fn(u64) -> f32, 0, "always"),
        (
            &|step| if step % 3 == 0 { -1.0 } else { -2.345 - 0.01 * step as f32 },
            40,
            "now and then",
        ),
        (&|step| -0.7 - 0.1 * (step % 7) as f32, 60, "measured by a coarse monitor"),
        (&|step| -(step as f32 % 4.0), 60, "measured in whole amperes"),
    ] {
        let robot = imported(current, &|_| 2);
        assert_eq!(known(&robot), (expected, expected), "{why}");
        let notes = robot.notes.join("\n");
        assert_eq!(notes.contains("a current of exactly −1"), expected < 60, "{why}: {notes}");
    }
}

#[test]
fn packs_of_one_robot_are_summed_and_a_part_is_named() {
    let topics = ["/r/left/battery", "/r/right/battery"];
    let bag = || {
        let mut bag = bag_of(&topics, &["/r/cmd_vel"]);
        // The right one goes on alone, and is then joined by the left one again.
        for step in (5..60).filter(|step| step % 5 == 0) {
            let now_ns = START_NS + step * TENTH_NS;
            bag.message(topics[1], now_ns, &battery(now_ns, 14.0, -1.5));
            if step == 55 {
                let charged = BatteryState { percentage: 0.75, ..battery(now_ns, 10.0, -0.5) };
                bag.message(topics[0], now_ns, &charged);
            }
        }
        bag
    };
    let mapping = "[[robot]]\nname = \"r\"\nbattery = \"/r/left/battery\"\nbattery_wh = 100\n\
        packs = [{ topic = \"/r/right/battery\", wh = 300 }]\ncommand = \"/r/cmd_vel\"";
    let imported = bag().import(mapping).unwrap();
    let robot = &imported.robots[0];
    assert_eq!((robot.rows.len(), robot.battery.messages, imported.unusable.len()), (6, 22, 0));
    assert_eq!(robot.battery.topic, "/r/left/battery + /r/right/battery");
    let (first, last) = (&robot.rows[0], &robot.rows[5]);
    assert_eq!(
        (first.power_w, first.voltage_v, first.current_a, first.soc),
        (10.0, 10.0, 1.0, 0.5)
    );
    assert_eq!((last.power_w, last.voltage_v, last.soc), (26.0, 12.0, 0.5625));
    assert_contains(&robot.notes.join("\n"), ["2 packs are summed", "(7 messages came"]);
    // Without a mapping no part passes for a robot.
    assert_contains(&bag().import("").unwrap_err(), topics.iter().chain(&["packs"]));
    for (from, to, expected) in [
        ("battery_wh = 100\n", "", "battery_wh: found NaN"),
        ("wh = 300", "wh = -1", "packs.wh: found -1"),
    ] {
        let refused = mapping.replacen(from, to, 1).parse::<Mapping>().unwrap_err().to_string();
        assert_contains(&refused, [expected, "1e-9 to 1e9"]);
    }
}
