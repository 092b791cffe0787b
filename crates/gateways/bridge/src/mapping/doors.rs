//! Every kind of finding in every format that comes in live.

use joulebus_plausibility::{Expired, Origin, Quantity as Judged};
use joulebus_publisher::{Charger, Implausible, Judgement, RobotState};
use joulebus_ros_messages::{BatteryState, Header, Time, encode};
use joulebus_settings::ChargeReading;
use serde_json::{Value, json};

use crate::mapping::account::{Account, UnmappedRecord};
use crate::mapping::fields::{Fields, Flag, Number};
use crate::mapping::intake::{Holds, Intake};
use crate::mapping::observation::{Observation, PowerOf};
use crate::mapping::ros::incoming::{BatteryFields, CHARGING, DISCHARGING, Received, RosRoute};
use crate::mapping::topic::{Pattern, Template};
use crate::mapping::units::Quantity;

/// The outcome of each.
const TABLE: &str = "
| finding | planted | MQTT, fields | VDA 5050 | ROS 2, BatteryState |
|---|---|---|---|---|
|  | nothing | read | read | read |
| `sign` | a current of the other sign | alarm | alarm | alarm |
| `sign` | the other sign in every tenth reading | alarm | alarm | alarm |
| `sources` | the currents of two meters in turn | alarm | alarm | alarm |
| `unit` | mV, mA and mW without a unit in the mapping | alarm | alarm | alarm |
| `unit` | a charge of 0 to 100 where a share is expected, or the other way round | alarm | alarm | alarm |
| `unit` | mV beside A without a unit in the mapping | alarm | alarm | alarm |
| `hold` | a controller that fell silent | expires | expires | expires |
| `clock` | a robot's clock that stands still | read | read | read |
| `never-came` | a field that no message has | told | told | told |
| `saturation` | a monitor at 2^15 − 1 | told | told | told |
| `sentinel` | −999 in every tenth reading | alarm | alarm | alarm |
| `mismatch` | a power of another circuit | alarm | – | – |
| `constant` | a current of 0 in every reading | alarm | alarm | alarm |
| `constant` | a current of 0.01 A in every reading of a robot that drives | alarm | alarm | alarm |
| `constant` | a current of −1 A in every reading | alarm | alarm | told |
|  | a current of 0.3 A in every reading of a robot that rests | read | read | read |
|  | the charger, with a current into the battery, and a message that says so | no power | no power | no power |
|  | the charger, with a current of the other sign, and a message that says so | no power | no power | no power |
|  | the charger, with a full battery, and a message that says so | no power | no power | no power |
|  | the charger, and no message that says so | no power | no power | no power |
|  | energy fed back, and a message that says that it does not charge | read | read | read |

";

const FORMATS: [&str; 3] = ["MQTT, fields", "VDA 5050", "ROS 2, BatteryState"];
const STEP_NS: u64 = 100_000_000;

/// Voltage, current, speed and charge of a robot of 24 V, SI.
fn robot(step: u64, planted: &str) -> [f64; 4] {
    let at = step as f64;
    let mut load_a = 2.0 + 0.2 * (0.7 * at).sin() + 0.1 * (2.9 * at).cos();
    let volt = 24.0 - 0.1 * load_a + 0.01 * (5.1 * at).sin();
    let mut v = 0.2 + 0.05 * (0.3 * at).sin();
    match planted {
        "a monitor at 2^15 − 1" if step % 7 < 4 => load_a = 3.2767,
        "−999 in every tenth reading" if step.is_multiple_of(10) => load_a = -999.0,
        "the other sign in every tenth reading" if step.is_multiple_of(10) => load_a = -load_a,
        "the currents of two meters in turn" if step.is_multiple_of(2) => load_a *= 0.1,
        "a current of 0 in every reading" => load_a = 0.0,
        _ if planted.starts_with("a current of 0.01 A") => load_a = 0.01,
        _ if planted.starts_with("a current of −1 A") => load_a = -1.0,
        _ if planted.starts_with("a current of 0.3 A") => [load_a, v] = [0.3, 0.0],
        _ if is_docked(step, planted) => {
            v = 0.0;
            load_a = if planted.contains("other sign") { 2.9 } else { -2.9 } + 0.1 * load_a;
        }
        _ => {}
    }
    [volt, load_a, v, 0.8 - 1e-5 * at]
}

/// True if a robot is where its battery is charged: after it has driven.
fn is_docked(step: u64, planted: &str) -> bool {
    step >= 150 && (planted.starts_with("the charger") || planted.starts_with("energy"))
}

/// True if no monitor measures the current.
fn is_unmeasured(planted: &str) -> bool {
    ["a current of 0.01 A", "a current of −1 A"].iter().any(|current| planted.starts_with(current))
}

/// What a message says of charging.
fn says_charging(step: u64, planted: &str) -> Option<bool> {
    let is_silent = planted.ends_with("no message that says so");
    (!is_silent).then(|| is_docked(step, planted) && planted.starts_with("the charger"))
}

fn document(fields: &Fields, document: &Value, account: &mut Account) -> Observation {
    let seen = fields.read(document, |reason, name| {
        account.count("topic", reason, name);
    });
    account.came("topic", "r7", &fields.came(&seen));
    seen
}

/// A number of a document, read with what remedies say of it.
fn number(name: &str, quantity: Quantity, at: &str, remedies: &str) -> Option<Number> {
    let mut number = Number::si(quantity, at);
    number.negate = remedies.contains("negate = true") && ["power", "current"].contains(&name);
    for edit in remedies.split(&format!("{name} = {{ at = …, ")).skip(1) {
        let (key, value) = edit.split_once(" = ").unwrap();
        match key {
            "unit" => number.unit = quantity.unit(value.split('"').nth(1).unwrap()).unwrap(),
            _ => number.path.unknown = serde_json::from_str(&value[..6]).unwrap(),
        }
    }
    Some(number)
}

fn message(
    (format, remedies): (&str, &str),
    planted: &str,
    step: u64,
    account: &mut Account,
) -> Observation {
    let [mut volt, mut ampere, v, mut soc] = robot(step, planted);
    if planted.starts_with("a charge") {
        // VDA 5050 defines a percentage.
        soc *= if format == "VDA 5050" { 0.01 } else { 100.0 };
    }
    if planted.starts_with("mV") {
        volt *= 1e3;
    }
    if planted.starts_with("mV,") {
        ampere *= 1e3;
    }
    if planted == "a current of the other sign" {
        ampere = -ampere;
    }
    let commands = planted != "a controller that fell silent" || step < 50;
    let stamp = if planted.starts_with("a robot's clock") { 0 } else { step };
    let has_soc = planted != "a field that no message has";
    match format {
        "MQTT, fields" => {
            let number = |name, quantity, at| number(name, quantity, at, remedies);
            let fields = Fields {
                v: number("v", Quantity::Speed, "v"),
                // Of a robot that measures no power.
                power: number("power", Quantity::Power, "power")
                    .filter(|_| !is_unmeasured(planted)),
                power_of_current: is_unmeasured(planted),
                power_of: PowerOf::Battery,
                voltage: number("voltage", Quantity::Voltage, "volt"),
                current: number("current", Quantity::Current, "ampere"),
                soc: number("soc", Quantity::Share, "soc"),
                charging: says_charging(step, planted).map(|_| Flag::at("/charging")),
                ..Fields::default()
            };
            let power = volt
                * ampere
                * match planted {
                    "a power of another circuit" => 1.5,
                    // mW, or W.
                    _ if planted.starts_with("mV") => 1e-3,
                    _ => 1.0,
                };
            let mut sent = json!({"stamp": stamp, "power": power, "volt": volt, "ampere": ampere});
            if let Some(charging) = says_charging(step, planted) {
                sent["charging"] = json!(charging);
            }
            if commands {
                sent["v"] = json!(v);
            }
            if has_soc {
                sent["soc"] = json!(soc);
            }
            document(&fields, &sent, account)
        }
        "VDA 5050" => {
            let mut supply = json!({"batteryVoltage": volt, "batteryCurrent": ampere});
            if let Some(charging) = says_charging(step, planted) {
                supply["charging"] = json!(charging);
            }
            if has_soc {
                supply["stateOfCharge"] = json!(100.0 * soc);
            }
            let mut sent = json!({"version": "3.0.0", "timestamp": stamp, "powerSupply": supply});
            if commands {
                sent["velocity"] = json!({"vx": v, "vy": 0.0, "omega": 0.0});
            }
            document(&Fields::vda5050(false), &sent, account)
        }
        _ => {
            let route = RosRoute {
                name: "/{robot}/battery".to_owned(),
                topic: Template::parse("/{robot}/battery", "lab", true).unwrap(),
                pattern: Pattern::parse("/{robot}/battery").unwrap(),
                kind: joulebus_ros_messages::RosType::BatteryState,
                battery: BatteryFields {
                    discharge_is_positive: false,
                    percentage: Quantity::Share.si(),
                    power_of: Some(PowerOf::Battery),
                    pack: None,
                },
                says: None,
            };
            let state = BatteryState {
                header: Header {
                    stamp: Time { sec: stamp as i32, nanosec: 0 },
                    frame_id: String::new(),
                },
                voltage: volt as f32,
                temperature: f32::NAN,
                // Negative while discharging, and where it is not measured.
                current: if ampere == -1.0 { -1.0 } else { -ampere as f32 },
                charge: f32::NAN,
                capacity: f32::NAN,
                design_capacity: f32::NAN,
                percentage: if has_soc { soc as f32 } else { f32::NAN },
                power_supply_status: match says_charging(step, planted) {
                    None => 0,
                    Some(true) if planted.contains("full") => 4,
                    Some(true) => CHARGING,
                    Some(false) if is_docked(step, planted) => 3,
                    Some(false) => DISCHARGING,
                },
                power_supply_health: 0,
                power_supply_technology: 0,
                present: true,
                cell_voltage: Vec::new(),
                cell_temperature: Vec::new(),
                location: String::new(),
                serial_number: String::new(),
            };
            let received = Received::new([0, 1], &encode(&state).unwrap());
            let (mut seen, _) = route.read("r7", &received, account).unwrap_or_default();
            // Another topic's.
            seen.v_mps = commands.then_some(v as f32);
            seen
        }
    }
}

/// The last sample of a robot with a fault, what is found of it, and what is not mapped.
fn run(
    (format, remedies): (&str, &str),
    planted: &str,
) -> (Option<RobotState>, Vec<Implausible>, Vec<UnmappedRecord>) {
    let holds = Holds {
        command_ns: 5 * STEP_NS,
        expired: Expired::Unknown,
        reading_ns: 10 * STEP_NS,
        silent_ns: 50 * STEP_NS,
    };
    let names = ["power_W", "voltage_V", "current_A", "soc_share"];
    let names = Judged::ALL.into_iter().zip(names.map(str::to_owned));
    let names = names.filter(|_| format == FORMATS[0]).collect();
    let judgement = Judgement::new(Origin::Bridge, Vec::new()).named(names);
    let mut intake = Intake::new(holds, false, [(7, ChargeReading::Load)]).judged_by(judgement);
    let mut account = Account::default();
    let mut last = None;
    for step in 0..300 {
        let seen = message((format, remedies), planted, step, &mut account);
        intake.take(7, &seen, step * STEP_NS);
        last = intake.sample(7, step * STEP_NS);
    }
    (last, intake.judgement().records(), account.records())
}

/// The outcome of a fault: the alarm, a word in log and status, or a rule that corrects it.
fn cell(format: &str, (kind, planted): (&str, &str)) -> String {
    let (last, found, unmapped) = run((format, ""), planted);
    let of_kind = found.iter().find(|one| one.finding.kind.name() == kind);
    let state = last.as_ref().unwrap();
    if is_unmeasured(planted) {
        assert!(state.current_a.is_none(), "{format}, {planted}: {state:?}");
    }
    let is_charging = planted.starts_with("the charger");
    if is_charging || is_unmeasured(planted) {
        assert!(state.power_w.is_none(), "{format}, {planted}: {state:?}");
    } else if kind.is_empty() {
        assert!(state.power_w.is_some(), "{format}, {planted}: {state:?}");
    }
    assert_eq!(state.charger != Charger::Disconnected, is_charging, "{format}, {planted}");
    if let Some(one) = of_kind {
        let severity = if one.finding.is_error() { "alarm" } else { "told" };
        let remedies: String = found.iter().map(|one| one.remedy.as_str()).collect();
        // Keys that a remedy names leave no finding, and a format without them has none.
        let has_keys = remedies.contains("at = …") || remedies.contains("negate");
        let mends = ["a current of the other sign", "mV, mA", "a charge of", "mV beside", "−999"];
        let must = format == FORMATS[0] && mends.iter().any(|mends| planted.starts_with(mends));
        assert_eq!(has_keys, must, "{format}, {planted}: {remedies}");
        if must {
            let (_, left, _) = run((format, &remedies), planted);
            let is_error = |one: &Implausible| one.finding.is_error();
            assert!(!left.iter().any(is_error), "{planted}: {remedies}: {left:?}");
        }
        return severity.to_owned();
    }
    assert!(found.is_empty(), "{format}, {planted}: {found:?}");
    let expired = last.is_some_and(|state| state.v_mps.is_none());
    let is_told = |reason: &str| unmapped.iter().any(|one| one.reason == reason);
    match kind {
        // VDA 5050 requires the field that says so.
        "" if is_charging && unmapped.iter().all(|one| one.reason == "never_came") => {
            "no power".to_owned()
        }
        "" | "clock" if unmapped.is_empty() => "read".to_owned(),
        "constant" if is_told("unknown") => "told".to_owned(),
        "hold" if expired => "expires".to_owned(),
        // Or a percentage that is NaN.
        "never-came" if is_told("never_came") || is_told("unknown") => "told".to_owned(),
        // Their power is voltage times current.
        "mismatch" if format != FORMATS[0] => "–".to_owned(),
        _ => panic!("{format}, {planted}: silent; {unmapped:?}"),
    }
}

#[test]
fn no_format_is_silent_about_any_kind() {
    let mut text =
        format!("\n| finding | planted | {} |\n|{}\n", FORMATS.join(" | "), "---|".repeat(5));
    for line in TABLE.lines().filter(|line| line.starts_with("| ")).skip(1) {
        let [kind, planted] = [1, 2].map(|at| line.split('|').nth(at).unwrap().trim());
        let cells = FORMATS.map(|format| cell(format, (kind.trim_matches('`'), planted)));
        text += &format!("| {kind} | {planted} | {} |\n", cells.join(" | "));
    }
    text.push('\n');
    assert_eq!(text, TABLE, "write this table:\n{text}");
}
