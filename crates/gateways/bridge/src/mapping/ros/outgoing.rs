//! Values of robots as ROS 2 messages.
//!
//! `sensor_msgs/BatteryState` follows its definition: the current is negative while discharging,
//! and NaN means unknown. It has no fields for powers. These are published as `std_msgs/Float64`
//! and among the diagnostics, with their unit in the key.

use joulebus_consumer::wire::OUTLOOK_S;
use joulebus_publisher::Implausible;
use joulebus_ros_messages::{
    BatteryState, DiagnosticArray, DiagnosticStatus, Float64, Header, KeyValue, Outlook, Time,
};
use serde_json::Value;

use crate::mapping::outgoing::{Object, is_of_outlook, number, value_names};
use crate::mapping::ros::incoming::{CHARGING, DISCHARGING};
use crate::mapping::simulated::ClockState;

/// `diagnostic_msgs/DiagnosticStatus`: not measured.
const STALE: u8 = 3;
/// Size of a robot's status with alarms and all values, bytes.
pub(crate) const STATUS_BYTES: usize = 1_300;
/// Values of a robot that are not among the diagnostics: fields of the status itself, times of
/// values, and how long a ledger has counted.
const NOT_DIAGNOSED: [&str; 8] = [
    "robot",
    "name",
    "stamp_unix_ns",
    "target_unix_ns",
    "level",
    "alarms",
    "metered_s",
    "unmetered_s",
];

/// The values of a robot among the diagnostics, beside its alarms. Those of outlooks are not among
/// them, because the worker would have to compute them.
fn diagnosed() -> impl Iterator<Item = &'static str> {
    value_names().filter(|name| !NOT_DIAGNOSED.contains(name) && !is_of_outlook(name))
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum RosWhat {
    /// The forecast of a robot's next reading, as a battery's voltage and current.
    Forecast,
    /// The state of charge of a robot's battery.
    Budget,
    /// The energy that a robot will draw if it goes on as it does.
    Outlook,
    Value,
    /// Levels, alarms, forecasts and budgets of all robots, and the worker.
    Diagnostics,
}

impl RosWhat {
    pub(crate) const fn is_of_robot(self) -> bool {
        !matches!(self, Self::Diagnostics)
    }

    /// True if a late subscriber gets the last message. Others would be old.
    pub(crate) const fn is_latched(self) -> bool {
        matches!(self, Self::Budget | Self::Diagnostics)
    }

    pub(crate) const fn type_name(self) -> &'static str {
        match self {
            Self::Forecast | Self::Budget => "sensor_msgs/msg/BatteryState",
            Self::Outlook => "joulebus_msgs/msg/Outlook",
            Self::Value => "std_msgs/msg/Float64",
            Self::Diagnostics => "diagnostic_msgs/msg/DiagnosticArray",
        }
    }
}

/// The forecast of a robot's next reading. `voltage_v` is the measured voltage of its battery.
pub(crate) fn forecast(name: &str, values: &Object, voltage_v: Option<f32>) -> BatteryState {
    let power_w = number("power_w", values);
    let current_a = voltage_v
        .filter(|voltage_v| *voltage_v > 0.0)
        .map_or(f64::NAN, |voltage_v| -power_w / f64::from(voltage_v));
    BatteryState { current: current_a as f32, ..battery(name, "target_unix_ns", values, voltage_v) }
}

pub(crate) fn budget(name: &str, values: &Object, voltage_v: Option<f32>) -> BatteryState {
    let voltage = voltage_v.filter(|voltage_v| *voltage_v > 0.0).map_or(f64::NAN, f64::from);
    let ah = |joules: &str| (number(joules, values) / 3_600.0 / voltage) as f32;
    BatteryState {
        percentage: number("soc", values) as f32,
        charge: ah("usable_j"),
        capacity: ah("capacity_j"),
        ..battery(name, "stamp_unix_ns", values, voltage_v)
    }
}

/// The energy that a robot will draw over each horizon.
pub(crate) fn outlook(name: &str, values: &Object) -> Outlook {
    let stamp_ns = values.get("stamp_unix_ns").and_then(Value::as_u64);
    let f32_of = |value: &str| number(value, values) as f32;
    let energy = |end| OUTLOOK_S.map(|horizon_s| f32_of(&format!("energy_{horizon_s}s_{end}")));
    Outlook {
        header: header(stamp_ns.unwrap_or(0), name),
        horizon_s: OUTLOOK_S,
        energy_j: energy("j"),
        energy_lo_j: energy("lo_j"),
        energy_hi_j: energy("hi_j"),
        usable_j: f32_of("usable_j"),
        time_to_empty_s: f32_of("time_to_empty_s"),
        time_to_empty_lo_s: f32_of("time_to_empty_lo_s"),
        time_to_empty_hi_s: f32_of("time_to_empty_hi_s"),
        capacity_j: f32_of("capacity_j"),
        capacity_sd_j: f32_of("capacity_sd_j"),
        time_to_80_s: f32_of("time_to_80_s"),
        time_to_full_s: f32_of("time_to_full_s"),
    }
}

/// One value of a robot. NaN if it is not known.
pub(crate) fn value(name: &str, values: &Object) -> Float64 {
    Float64 { data: number(name, values) }
}

pub(crate) fn robot_status(name: &str, values: &Object) -> DiagnosticStatus {
    let text = |value: &str| values.get(value).and_then(Value::as_str);
    let level = match text("level") {
        Some("ok") => 0,
        Some("warn") => 1,
        Some("error") => 2,
        _ => STALE,
    };
    let alarms = values.get("alarms").and_then(Value::as_array);
    let alarms: Vec<&str> = alarms.into_iter().flatten().filter_map(Value::as_str).collect();
    let message = match (level, alarms.is_empty()) {
        (0, true) => "OK".to_owned(),
        (_, true) => "no data".to_owned(),
        _ => alarms.join(", "),
    };
    let shown = |value: &str| match values.get(value) {
        None | Some(Value::Null) => "unknown".to_owned(),
        Some(Value::String(text)) => text.clone(),
        Some(other) => other.to_string(),
    };
    let values = diagnosed().map(|value| KeyValue { key: value.to_owned(), value: shown(value) });
    DiagnosticStatus {
        level,
        name: format!("joulebus: {name}"),
        message,
        hardware_id: name.to_owned(),
        values: values.collect(),
    }
}

/// The status of a robot without a worker: everything is unknown.
pub(crate) fn unknown_status(name: &str, worker: &str) -> DiagnosticStatus {
    DiagnosticStatus {
        level: STALE,
        name: format!("joulebus: {name}"),
        message: format!("worker {worker}"),
        hardware_id: name.to_owned(),
        values: Vec::new(),
    }
}

/// Adds something implausible about a robot to its status: a warning, whatever its alarms are.
pub(crate) fn add_implausible(status: &mut DiagnosticStatus, found: &Implausible) {
    let kind = found.finding.kind;
    status.message = match status.level {
        0 => format!("implausible {kind}"),
        _ => format!("{}, implausible {kind}", status.message),
    };
    status.level = status.level.max(1);
    status.values.push(KeyValue {
        key: format!("implausible_{kind}"),
        value: format!("{}: {}", found.finding, found.remedy),
    });
}

pub(crate) fn worker_status(
    (fleet, bridge): (&str, &str),
    (level, worker): (u8, &str),
    counts: [(&str, u64); 4],
) -> DiagnosticStatus {
    let counts = counts
        .into_iter()
        .map(|(key, count)| KeyValue { key: key.to_owned(), value: count.to_string() });
    DiagnosticStatus {
        level,
        name: format!("joulebus: worker of {fleet}"),
        message: format!("worker {worker}"),
        hardware_id: bridge.to_owned(),
        values: counts.collect(),
    }
}

/// Adds to the worker's status that the simulated clock does not run: a warning.
pub(crate) fn add_clock(status: &mut DiagnosticStatus, clock: ClockState) {
    let what = match clock {
        ClockState::Runs => return,
        ClockState::Missing => "no /clock",
        ClockState::Stands => "/clock stands",
    };
    status.message = format!("{}, {what}", status.message);
    status.level = status.level.max(1);
}

/// All statuses in one message, because a subscriber of a latched topic keeps one.
pub(crate) fn diagnostics(now_unix_ns: u64, status: Vec<DiagnosticStatus>) -> DiagnosticArray {
    DiagnosticArray { header: header(now_unix_ns, ""), status }
}

/// A battery whose voltage is known, and whether it is charged.
fn battery(name: &str, stamp: &str, values: &Object, voltage_v: Option<f32>) -> BatteryState {
    let stamp_ns = values.get(stamp).and_then(Value::as_u64);
    let charging = values.get("charging").and_then(Value::as_bool);
    BatteryState {
        header: header(stamp_ns.unwrap_or(0), name),
        voltage: voltage_v.unwrap_or(f32::NAN),
        temperature: f32::NAN,
        current: f32::NAN,
        charge: f32::NAN,
        capacity: f32::NAN,
        design_capacity: f32::NAN,
        percentage: f32::NAN,
        power_supply_status: match charging {
            None => 0,
            Some(true) => CHARGING,
            Some(false) => DISCHARGING,
        },
        power_supply_health: 0,
        power_supply_technology: 0,
        present: true,
        cell_voltage: Vec::new(),
        cell_temperature: Vec::new(),
        location: String::new(),
        serial_number: String::new(),
    }
}

fn header(unix_ns: u64, frame_id: &str) -> Header {
    let stamp = Time {
        sec: i32::try_from(unix_ns / 1_000_000_000).unwrap_or(i32::MAX),
        nanosec: (unix_ns % 1_000_000_000) as u32,
    };
    Header { stamp, frame_id: frame_id.to_owned() }
}

#[cfg(test)]
mod tests {
    use joulebus_plausibility::Origin;
    use joulebus_publisher::{Judgement, RobotState};
    use joulebus_ros_messages::{Message, RosType, encode};
    use serde_json::json;

    use super::*;

    fn values() -> Object {
        let values = json!({
            "power_w": 48.0, "soc": 0.5, "usable_j": 86_400.0, "charging": false, "level": "warn",
            "capacity_j": 172_800.0, "capacity_sd_j": 3_600.0, "time_to_full_s": 5_400,
            "alarms": ["StuckSensor", "HeldTooLong"], "quality": "Held",
            "stamp_unix_ns": 1_700_000_000_000_000_001_u64, "target_unix_ns": 1_700_000_000_500_000_000_u64,
        });
        match values {
            Value::Object(values) => values,
            _ => Object::new(),
        }
    }

    #[test]
    fn a_forecast_is_a_current_that_is_negative_while_discharging() {
        let message = forecast("r1", &values(), Some(24.0));
        assert_eq!((message.voltage, message.current), (24.0, -2.0));
        assert_eq!(message.power_supply_status, DISCHARGING);
        assert_eq!(
            (message.header.stamp.sec, message.header.stamp.nanosec),
            (1_700_000_000, 500_000_000)
        );
        assert_eq!(message.header.frame_id, "r1");
        for unknown in [message.percentage, message.charge, message.temperature, message.capacity] {
            assert!(unknown.is_nan());
        }
        for voltage_v in [None, Some(0.0)] {
            assert!(forecast("r1", &values(), voltage_v).current.is_nan());
        }
        let nothing = forecast("r1", &Object::new(), Some(24.0));
        assert!(nothing.current.is_nan() && nothing.power_supply_status == 0);
    }

    #[test]
    fn a_budget_is_a_charge_and_a_percentage() {
        let message = budget("r1", &values(), Some(24.0));
        assert_eq!((message.percentage, message.charge, message.capacity), (0.5, 1.0, 2.0));
        assert!(message.current.is_nan());
        assert_eq!(message.header.stamp.nanosec, 1);
        let message = budget("r1", &values(), None);
        assert!(message.percentage == 0.5 && message.charge.is_nan() && message.voltage.is_nan());
        assert!(message.capacity.is_nan());
        let bytes: Vec<u8> = [0, 1, 0, 0].into_iter().chain(encode(&message).unwrap()).collect();
        let Message::BatteryState(again) = RosType::BatteryState.decode(&bytes).unwrap() else {
            panic!("another type");
        };
        assert_eq!((again.percentage, again.header), (0.5, message.header));
    }

    #[test]
    fn an_outlook_has_four_horizons_the_time_to_empty_and_the_battery() {
        let mut values = values();
        values.insert("energy_10s_hi_j".to_owned(), json!(480.5));
        values.insert("time_to_empty_s".to_owned(), json!(1_800));
        let message = outlook("r1", &values);
        assert_eq!(message.horizon_s, [1.0, 10.0, 60.0, 300.0]);
        assert_eq!((message.energy_hi_j[1], message.time_to_empty_s), (480.5, 1_800.0));
        assert!(message.energy_hi_j[0].is_nan() && message.energy_j[1].is_nan());
        assert_eq!((message.capacity_j, message.capacity_sd_j), (172_800.0, 3_600.0));
        assert!(message.time_to_full_s == 5_400.0 && message.time_to_80_s.is_nan());
        assert_eq!((message.usable_j, message.header.frame_id.as_str()), (86_400.0, "r1"));
    }

    #[test]
    fn diagnostics_have_levels_alarms_and_values() {
        let status = robot_status("r1", &values());
        assert_eq!((status.level, status.name.as_str()), (1, "joulebus: r1"));
        assert_eq!(status.message, "StuckSensor, HeldTooLong");
        let of = |key: &str| status.values.iter().find(|entry| entry.key == key).unwrap();
        assert_eq!((of("power_w").value.as_str(), of("lo_w").value.as_str()), ("48.0", "unknown"));
        assert_eq!(robot_status("r1", &Object::new()).level, STALE);
        assert_eq!(unknown_status("r1", "gone").message, "worker gone");
        for (clock, level, message) in [
            (ClockState::Runs, 0, "worker live"),
            (ClockState::Stands, 1, "worker live, /clock stands"),
            (ClockState::Missing, 1, "worker live, no /clock"),
        ] {
            let mut status = worker_status(("lab", "b"), (0, "live"), [("messages", 1); 4]);
            add_clock(&mut status, clock);
            assert_eq!((status.level, status.message.as_str()), (level, message));
        }
        let mut judgement = Judgement::new(Origin::Bridge, Vec::new());
        for step in 0..200 {
            let mut state = RobotState::new(1);
            state.power_w = Some(-40.0 - (step % 7) as f32);
            state.v_mps = Some(0.5);
            judgement.take(&state, None, step * 100_000_000);
        }
        let mut status = robot_status("r1", &Object::new());
        status.level = 0;
        add_implausible(&mut status, &judgement.records()[0]);
        assert_eq!((status.level, status.message.as_str()), (1, "implausible sign"));
        let last = &status.values.last().unwrap().value;
        assert!(last.contains("turn the sign with the other `current`"), "{last}");
        let bytes = encode(&diagnostics(1, vec![status; 100])).unwrap().len();
        assert!(bytes < 100 * STATUS_BYTES, "{bytes}");
    }
}
