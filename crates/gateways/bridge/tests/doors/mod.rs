//! What is said means the same at every door: files, bags, and messages of MQTT, VDA 5050 and
//! ROS 2. Each cell compares a door with [`Said::map`], or states why the door cannot say it.

use std::collections::BTreeMap;
use std::io::Cursor;

use joulebus_capture_format::import::{Mapping, import};
use joulebus_dataset::trial::{Column, ColumnMap, Trial};
use joulebus_plausibility::{Field, Mapped, PowerOf, Said};
use joulebus_ros_messages::{
    BatteryState, Header, Odometry, Pose, PoseWithCovariance, Quaternion, RosType, Time, Twist,
    TwistWithCovariance, Vector3, encode,
};
use serde_json::{Value, json};

use crate::mapping::account::Account;
use crate::mapping::fields::{Fields, Flag, Number};
use crate::mapping::observation::Observation;
use crate::mapping::ros::incoming::{BatteryFields, Received, RosRoute};
use crate::mapping::topic::{Pattern, Template};
use crate::mapping::units::Quantity;

const DOORS: [&str; 8] =
    ["CSV", "read_table", ".npy", "bag", "MQTT", "VDA 5050 2", "VDA 5050 3", "DDS"];
const FIELDS: [&str; 12] = [
    "v",
    "vy",
    "omega",
    "v_meas",
    "omega_meas",
    "power",
    "voltage",
    "current",
    "soc",
    "charging",
    "full",
    "present",
];
/// Numbers that a field says. None: it says nothing.
const CASES: [Option<f64>; 10] = [
    Some(0.5),
    Some(-0.25),
    Some(0.0),
    Some(40.0),
    Some(-1.0),
    Some(-0.01),
    Some(f64::NAN),
    Some(f64::INFINITY),
    Some(1e39),
    None,
];

/// Values of all fields, with one of them changed. NaN where nothing is said.
#[derive(Clone, Copy)]
struct Says([f64; FIELDS.len()]);

impl Says {
    fn new(field: usize, case: Option<f64>) -> Self {
        let mut all = [0.2, 0.0, 0.1, 0.3, 0.15, f64::NAN, 24.0, 2.0, 0.5, 0.0, 0.0, 1.0];
        // A battery without a voltage may be absent.
        all[6] = if FIELDS[field] == "present" { 0.0 } else { all[6] };
        all[field] = case.unwrap_or(f64::NAN);
        Self(all)
    }

    fn of(&self, name: &str) -> f64 {
        FIELDS.iter().position(|field| *field == name).map_or(f64::NAN, |at| self.0[at])
    }

    fn is(&self, name: &str) -> bool {
        self.of(name) > 0.0
    }

    /// What is known by the function that all doors call.
    fn mapped(&self, soc_unit: f64) -> Mapped {
        let said = Said {
            soc_unit,
            product_of: Some(PowerOf::Battery),
            present: Some(self.is("present")),
            charging: Some(self.is("charging")),
            full: Some(self.is("full")),
            ..Said::default()
        };
        let fields = [
            (Field::V, "v"),
            (Field::Vy, "vy"),
            (Field::Omega, "omega"),
            (Field::VMeasured, "v_meas"),
            (Field::OmegaMeasured, "omega_meas"),
            (Field::Power, "power"),
            (Field::Voltage, "voltage"),
            (Field::Current, "current"),
            (Field::Soc, "soc"),
        ];
        fields
            .into_iter()
            .fold(said, |said, (of, name)| said.with(of, self.of(name)))
            .map(|_, _| {})
    }
}

fn flag(value: Option<bool>) -> f64 {
    value.map_or(f64::NAN, |value| f64::from(u8::from(value)))
}

/// The value of a field in an observation of a message.
fn seen(seen: Option<&Observation>, field: &str) -> f64 {
    let Some(seen) = seen else {
        return f64::NAN;
    };
    let number = match field {
        "v" | "vy" => seen.v_mps,
        "omega" => seen.omega_radps,
        "power" => seen.power.map(|power| power.power_w),
        "voltage" | "present" => seen.voltage_v,
        "current" => seen.current_a,
        "soc" => seen.soc,
        "charging" => return flag(seen.charging),
        _ => return flag(seen.full),
    };
    number.map_or(f64::NAN, f64::from)
}

fn expected(mapped: &Mapped, field: &str) -> f64 {
    let seen = &mapped.seen;
    match field {
        "v" | "vy" => seen.v_mps,
        "omega" => seen.omega_radps,
        "v_meas" => seen.v_measured_mps,
        "omega_meas" => seen.omega_measured_radps,
        "power" => seen.power_w,
        "voltage" | "present" => seen.voltage_v,
        "current" => seen.current_a,
        "soc" => seen.soc,
        "charging" => flag(seen.charging),
        _ => flag(mapped.full),
    }
}

/// The value of a field in the first row of a file. A row that is refused says nothing.
fn in_trial(trials: Option<Vec<Trial>>, field: &str) -> f64 {
    let column = match field {
        "v" | "vy" => Column::V,
        "omega" => Column::Omega,
        "v_meas" => Column::VMeasured,
        "omega_meas" => Column::OmegaMeasured,
        "power" => Column::Power,
        "voltage" => Column::Voltage,
        "current" => Column::Current,
        _ => Column::Soc,
    };
    let trial = trials.and_then(|trials| trials.into_iter().next());
    let value = |trial: &Trial| match field {
        "charging" => flag(Some(trial.is_on_charger(0))),
        _ => trial.column(column).map_or(f64::NAN, |values| values[0]),
    };
    trial.as_ref().map_or(f64::NAN, value)
}

fn table(says: Says, own_power: bool) -> String {
    let mut text = "timestamp_s,vx,vy,omega_cmd_radps,v_meas_mps,omega_meas_radps,voltage_V,\
                    current_A,soc_share,charging"
        .to_owned();
    text += if own_power { ",power_W\n" } else { "\n" };
    let names = ["v", "vy", "omega", "v_meas", "omega_meas", "voltage", "current", "soc"];
    for row in 0..3 {
        text += &row.to_string();
        for name in names {
            text += &format!(",{}", says.of(name));
        }
        text += &format!(",{}", u8::from(says.is("charging")));
        text += &if own_power { format!(",{}\n", says.of("power")) } else { "\n".to_owned() };
    }
    text
}

fn array(says: Says) -> Vec<u8> {
    let mut header = "{'descr': '<f8', 'fortran_order': False, 'shape': (3, 11), }".to_owned();
    header += &" ".repeat(128 - 10 - header.len() - 1);
    let mut bytes = b"\x93NUMPY\x01\0v\0".to_vec();
    bytes.extend(format!("{header}\n").bytes());
    for row in 0..3 {
        let nan = f64::NAN;
        let [volt, ampere] = ["voltage", "current"].map(|name| 1e3 * says.of(name));
        let power = 1e3 * says.of("power");
        let values = [
            1.0,
            f64::from(row),
            nan,
            says.of("v"),
            says.of("omega"),
            nan,
            nan,
            nan,
            volt,
            ampere,
            power,
        ];
        bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    }
    bytes
}

fn battery(says: Says) -> BatteryState {
    BatteryState {
        header: Header { stamp: Time { sec: 1, nanosec: 0 }, frame_id: String::new() },
        voltage: says.of("voltage") as f32,
        temperature: f32::NAN,
        current: -says.of("current") as f32,
        charge: f32::NAN,
        capacity: f32::NAN,
        design_capacity: f32::NAN,
        percentage: says.of("soc") as f32,
        power_supply_status: match (says.is("full"), says.is("charging")) {
            (true, _) => 4,
            (false, true) => 1,
            (false, false) => 2,
        },
        power_supply_health: 0,
        power_supply_technology: 0,
        present: says.is("present"),
        cell_voltage: Vec::new(),
        cell_temperature: Vec::new(),
        location: String::new(),
        serial_number: String::new(),
    }
}

fn twist(v: f64, vy: f64, omega: f64) -> Twist {
    Twist { linear: Vector3 { x: v, y: vy, z: 0.0 }, angular: Vector3 { x: 0.0, y: 0.0, z: omega } }
}

fn bag(says: Says) -> Vec<u8> {
    let mut writer =
        mcap::WriteOptions::new().profile("ros2").create(Cursor::new(Vec::new())).unwrap();
    let mut channel = |topic: &str, kind: &str| {
        let schema = writer.add_schema(kind, "ros2msg", b"").unwrap();
        writer.add_channel(schema, topic, "cdr", &BTreeMap::new()).unwrap()
    };
    let channels = [
        channel("/cmd_vel", "geometry_msgs/msg/Twist"),
        channel("/odom", "nav_msgs/msg/Odometry"),
        channel("/battery_state", "sensor_msgs/msg/BatteryState"),
    ];
    let odometry = Odometry {
        header: Header { stamp: Time { sec: 1, nanosec: 0 }, frame_id: String::new() },
        child_frame_id: String::new(),
        pose: PoseWithCovariance {
            pose: Pose {
                position: Vector3 { x: 0.0, y: 0.0, z: 0.0 },
                orientation: Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 },
            },
            covariance: [[0.0; 6]; 6],
        },
        twist: TwistWithCovariance {
            twist: twist(says.of("v_meas"), 0.0, says.of("omega_meas")),
            covariance: [[0.0; 6]; 6],
        },
    };
    let bodies = [
        encode(&twist(says.of("v"), says.of("vy"), says.of("omega"))).unwrap(),
        encode(&odometry).unwrap(),
        encode(&battery(says)).unwrap(),
    ];
    for row in 0..3_u64 {
        for (channel_id, body) in channels.iter().zip(&bodies) {
            let at_ns = 1_700_000_000_000_000_000 + row * 100_000_000;
            let header = mcap::records::MessageHeader {
                channel_id: *channel_id,
                sequence: 0,
                log_time: at_ns,
                publish_time: at_ns,
            };
            writer.write_to_known_channel(&header, &[&[0, 1, 0, 0], &**body].concat()).unwrap();
        }
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

fn in_bag(says: Says, field: &str) -> f64 {
    let imported = import(Cursor::new(bag(says)), "r", &Mapping::default()).unwrap();
    let row = imported.robots.first().and_then(|robot| robot.rows.first());
    row.map_or(f64::NAN, |row| match field {
        "v" | "vy" => row.v_mps,
        "omega" => row.omega_radps,
        "v_meas" => row.v_measured_mps,
        "omega_meas" => row.omega_measured_radps,
        "voltage" | "present" => row.voltage_v,
        "current" => row.current_a,
        "soc" => row.soc,
        _ => flag(Some(row.on_charger)),
    })
}

/// JSON has no number for NaN and infinities.
fn document(pairs: &[(&str, f64)]) -> Value {
    pairs.iter().map(|(name, value)| ((*name).to_owned(), json!(value))).collect()
}

fn in_document(fields: &Fields, document: &Value, field: &str) -> f64 {
    seen(Some(&fields.read(document, |_, _| {})), field)
}

fn in_mqtt(says: Says, field: &str) -> f64 {
    let at = |quantity, name: &str| Some(Number::si(quantity, name));
    let fields = Fields {
        v: at(Quantity::Speed, "v"),
        vy: at(Quantity::Speed, "vy"),
        omega: at(Quantity::TurnRate, "omega"),
        power: at(Quantity::Power, "power"),
        power_of_current: true,
        voltage: at(Quantity::Voltage, "voltage"),
        current: at(Quantity::Current, "current"),
        soc: at(Quantity::Share, "soc"),
        charging: Some(Flag::at("charging")),
        full: Some(Flag::at("full")),
        ..Fields::default()
    };
    let names = ["v", "vy", "omega", "power", "voltage", "current", "soc"];
    let mut message = document(&names.map(|name| (name, says.of(name))));
    message["charging"] = json!(says.is("charging"));
    message["full"] = json!(says.is("full"));
    in_document(&fields, &message, field)
}

fn in_vda5050(says: Says, field: &str, is_new: bool) -> f64 {
    let velocity = document(
        &["v", "vy", "omega"].map(|name| (if name == "v" { "vx" } else { name }, says.of(name))),
    );
    let (charge, parent) = match is_new {
        true => ("stateOfCharge", "powerSupply"),
        false => ("batteryCharge", "batteryState"),
    };
    let mut supply = document(&[
        (charge, says.of("soc")),
        ("batteryVoltage", says.of("voltage")),
        ("batteryCurrent", says.of("current")),
    ]);
    supply["charging"] = json!(says.is("charging"));
    let mut message = json!({"version": "3.0.0", "velocity": velocity});
    message[parent] = supply;
    in_document(&Fields::vda5050(false), &message, field)
}

fn in_dds(says: Says, field: &str) -> f64 {
    let is_motion = ["v", "vy", "omega"].contains(&field);
    let (kind, body) = match is_motion {
        true => {
            (RosType::Twist, encode(&twist(says.of("v"), says.of("vy"), says.of("omega"))).unwrap())
        }
        false => (RosType::BatteryState, encode(&battery(says)).unwrap()),
    };
    let route = RosRoute {
        name: "/{robot}/x".to_owned(),
        topic: Template::parse("/{robot}/x", "lab", true).unwrap(),
        pattern: Pattern::parse("/{robot}/x").unwrap(),
        kind,
        battery: BatteryFields {
            discharge_is_positive: false,
            percentage: Quantity::Share.si(),
            power_of: Some(PowerOf::Battery),
            pack: None,
        },
        says: None,
    };
    let read = route.read("r", &Received::new([0, 1], &body), &mut Account::default());
    seen(read.as_ref().map(|(seen, _)| seen), field)
}

/// Why a door cannot say this.
fn reason(door: &str, field: &str, case: Option<f64>) -> Option<&'static str> {
    let is_flag = ["charging", "full", "present"].contains(&field);
    let is_file = ["CSV", "read_table", ".npy"].contains(&door);
    let is_ros = ["bag", "DDS"].contains(&door);
    let is_motion = ["v", "vy", "omega"].contains(&field);
    let known = case.unwrap_or(f64::NAN);
    match field {
        _ if is_flag && case != Some(0.5) && case != Some(0.0) => {
            Some("a truth value is no such number")
        }
        "vy" | "v_meas" | "omega_meas" | "soc" | "charging" if door == ".npy" => {
            Some("the layout has no such column")
        }
        "v_meas" | "omega_meas" if !is_file && door != "bag" => Some("a message has one velocity"),
        "power" if is_ros || door.starts_with("VDA") => Some("the message has no power"),
        "current" if door == "VDA 5050 2" => Some("its version has no current"),
        "full" if is_file || door == "bag" => Some("a row says that it charges, and no more"),
        "full" | "present" if !is_ros => Some("the format does not say it"),
        "soc" if door == "bag" && (known == 40.0 || known == -0.25 || known == 0.0) => {
            Some("a bag is read as a whole: its percentages are of one unit, and 0 in all is none")
        }
        "vy" if known.is_infinite() && ["MQTT", "VDA 5050 2", "VDA 5050 3"].contains(&door) => {
            Some("JSON has no such number")
        }
        "vy" if is_ros && known.is_nan() => Some("a Twist has a number, and NaN is none"),
        // A row of readings has both, or is refused.
        _ if door == "bag" && is_motion && (known.is_nan() || known > 1e30) => {
            Some("a command that is no number is refused, with all of it")
        }
        _ => None,
    }
}

#[test]
fn what_is_said_means_the_same_at_every_door() {
    let folder = tempfile::tempdir().unwrap();
    let (mut compared, mut reasons, mut wrong) = (0, 0, Vec::new());
    for door in DOORS {
        for (at, field) in FIELDS.into_iter().enumerate() {
            for case in CASES {
                if reason(door, field, case).is_some() {
                    reasons += 1;
                    continue;
                }
                let says = Says::new(at, case);
                let soc_unit = if door.starts_with("VDA") { 0.01 } else { 1.0 };
                let map = ColumnMap::default();
                let found = match door {
                    "CSV" => {
                        let path = folder.path().join("a.csv");
                        std::fs::write(&path, table(says, field == "power")).unwrap();
                        in_trial(Trial::read_mapped(&path, &map).ok(), field)
                    }
                    "read_table" => {
                        let text = Cursor::new(table(says, field == "power"));
                        in_trial(Trial::read_text("table", text, &map).ok(), field)
                    }
                    ".npy" => {
                        let path = folder.path().join("a.npy");
                        std::fs::write(&path, array(says)).unwrap();
                        in_trial(Trial::read_mapped(&path, &map).ok(), field)
                    }
                    "bag" => in_bag(says, field),
                    "MQTT" => in_mqtt(says, field),
                    "VDA 5050 2" => in_vda5050(says, field, false),
                    "VDA 5050 3" => in_vda5050(says, field, true),
                    _ => in_dds(says, field),
                };
                let mut expected = expected(&says.mapped(soc_unit), field);
                // A power of their own is none of voltage and current, and a row is refused where it is
                // no number.
                let has_own = [".npy", "CSV", "read_table"].contains(&door) && field == "power";
                if has_own && !case.is_some_and(|case| (case as f32).is_finite()) {
                    expected = f64::NAN;
                }
                compared += 1;
                let is_same = (found.is_nan() && expected.is_nan())
                    || (found - expected).abs() <= 1e-6 * expected.abs();
                if !is_same {
                    wrong.push(format!("{door}, {field}, {case:?}: {found}, and not {expected}"));
                }
            }
        }
    }
    println!("figure: {compared} cells compared, {reasons} with a reason");
    assert_eq!(compared + reasons, 8 * 12 * 10);
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
