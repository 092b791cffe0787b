//! The values of robots, and JSON documents of them.

use joulebus_board::{Newest, RobotRecord};
use joulebus_consumer::wire::{OUTLOOK_S, Outlook};
use serde_json::{Map, Value, json};

pub(crate) type Object = Map<String, Value>;

#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum What {
    Forecast,
    /// The energy that a robot has drawn and has left.
    Budget,
    /// The energy that a robot will draw if it goes on as it does.
    Outlook,
    Alarms,
    /// Every raise and clearance of an alarm, of robots and of the worker.
    AlarmChanges,
    /// The state of the bridge and of the worker, and the unmapped messages.
    Status,
}

impl What {
    pub(crate) const fn is_of_robot(self) -> bool {
        matches!(self, Self::Forecast | Self::Budget | Self::Outlook | Self::Alarms)
    }

    /// True if the broker retains the newest document for later subscribers by default.
    pub(crate) const fn is_kept(self) -> bool {
        matches!(self, Self::Budget | Self::Alarms | Self::Status)
    }

    /// The values of a document.
    pub(crate) fn usual(self) -> impl Iterator<Item = &'static str> {
        let names = match self {
            Self::Forecast => {
                "robot name quality stamp_unix_ns target_unix_ns reading_w reading_age_s \
                 power_w lo_w hi_w residual_w"
            }
            Self::Budget => {
                "robot name stamp_unix_ns drawn_j metered_s unmetered_s mean_power_w soc \
                 soc_lo soc_hi charging usable_j usable_lo_j time_to_empty_s \
                 time_to_empty_lo_s time_to_empty_hi_s capacity_j capacity_sd_j time_to_80_s \
                 time_to_full_s"
            }
            Self::Outlook => {
                "robot name stamp_unix_ns energy_1s_j energy_1s_lo_j energy_1s_hi_j \
                 energy_10s_j energy_10s_lo_j energy_10s_hi_j energy_60s_j energy_60s_lo_j \
                 energy_60s_hi_j energy_300s_j energy_300s_lo_j energy_300s_hi_j usable_j \
                 time_to_empty_s time_to_empty_lo_s time_to_empty_hi_s"
            }
            Self::Alarms => "robot name level alarms",
            Self::AlarmChanges | Self::Status => "",
        };
        names.split_ascii_whitespace()
    }
}

/// All values of a robot.
const VALUES: &str = "robot name quality quality_detail stamp_unix_ns target_unix_ns reading_w \
    reading_age_s power_w lo_w hi_w residual_w bias_w level alarms drawn_j metered_s unmetered_s \
    mean_power_w soc soc_lo soc_hi charging usable_j usable_lo_j time_to_empty_s \
    time_to_empty_lo_s time_to_empty_hi_s capacity_j capacity_sd_j time_to_80_s time_to_full_s \
    energy_1s_j energy_1s_lo_j energy_1s_hi_j energy_10s_j energy_10s_lo_j energy_10s_hi_j \
    energy_60s_j energy_60s_lo_j energy_60s_hi_j energy_300s_j energy_300s_lo_j energy_300s_hi_j";
/// Those that are no number with a unit.
const WITHOUT_UNIT: [&str; 8] = [
    "robot",
    "name",
    "quality",
    "quality_detail",
    "stamp_unix_ns",
    "target_unix_ns",
    "level",
    "alarms",
];

/// True if the value `name` is of an outlook, which the worker computes only for readers.
pub(crate) fn is_of_outlook(name: &str) -> bool {
    name.starts_with("energy_")
}

pub(crate) fn value_names() -> impl Iterator<Item = &'static str> {
    VALUES.split_ascii_whitespace()
}

/// Checks that there is such a value, and that it is a number.
pub(crate) fn check_number(name: &str) -> Result<(), String> {
    if WITHOUT_UNIT.contains(&name) {
        return Err("is no number".to_owned());
    }
    let is_value = value_names().any(|value| value == name);
    let all = || value_names().collect::<Vec<_>>().join(", ");
    is_value.then_some(()).ok_or_else(|| format!("is no value, allowed are {}", all()))
}

/// A value as a number. A boolean is 1 or 0. NaN if it is unknown.
pub(crate) fn number(name: &str, values: &Object) -> f64 {
    match values.get(name) {
        Some(Value::Bool(is_true)) => f64::from(u8::from(*is_true)),
        value => value.and_then(Value::as_f64).unwrap_or(f64::NAN),
    }
}

/// The document of a topic. Unknown values are null.
pub(crate) fn document(what: What, values: &Object) -> Value {
    let of = |name: &str| (name.to_owned(), values.get(name).cloned().unwrap_or(Value::Null));
    Value::Object(what.usual().map(of).collect())
}

/// All values of a robot. `unix_ns` converts this host's monotonic time to Unix time.
pub(crate) fn values(
    (robot, name): (u32, &str),
    newest: &Newest,
    outlook: Option<&Outlook>,
    unix_ns: impl Fn(u64) -> u64,
) -> Object {
    // A record is a struct with named fields, so it serialises to an object.
    let record = serde_json::to_value(RobotRecord::new(robot, newest));
    let mut values = match record {
        Ok(Value::Object(values)) => values,
        _ => Object::new(),
    };
    for (of, unix) in [("stamp_ns", "stamp_unix_ns"), ("target_ns", "target_unix_ns")] {
        let stamp_ns = values.remove(of).and_then(|stamp| stamp.as_u64());
        values.insert(unix.to_owned(), json!(stamp_ns.map(&unix_ns)));
    }
    let age_ns = values.remove("reading_age_ns").and_then(|age| age.as_f64());
    values.insert("reading_age_s".to_owned(), json!(age_ns.map(|age_ns| age_ns * 1e-9)));
    values.insert("name".to_owned(), json!(name));
    for (place, horizon_s) in OUTLOOK_S.into_iter().enumerate() {
        let bounds_j = outlook.and_then(|outlook| outlook.bounds_j(place));
        for (kind, joules) in [
            ("j", outlook.and_then(|outlook| outlook.expected_j(place))),
            ("lo_j", bounds_j.map(|(lo_j, _)| lo_j)),
            ("hi_j", bounds_j.map(|(_, hi_j)| hi_j)),
        ] {
            values.insert(format!("energy_{horizon_s}s_{kind}"), json!(joules));
        }
    }
    values
}

#[cfg(test)]
mod tests {
    use joulebus_consumer::wire::{
        Budget, Diagnostic, Forecast, Quality, budget_flag, forecast_flag, outlook_flag,
    };

    use super::*;

    fn newest() -> Newest {
        let (quality, quality_detail) = Quality::Held.encode();
        Newest {
            forecast: Forecast {
                robot: 7,
                flags: forecast_flag::POWER | forecast_flag::READING | forecast_flag::SAMPLE,
                quality,
                quality_detail,
                reading_w: 4.5,
                power_w: 4.75,
                stamp_ns: 100,
                target_ns: 130,
                reading_age_ns: 500_000_000,
                ..Forecast::default()
            },
            diagnostic: Some(Diagnostic {
                robot: 7,
                level: 2,
                alarms: 1 << 2,
                ..Diagnostic::default()
            }),
            budget: Some(Budget {
                robot: 7,
                flags: budget_flag::LEDGER | budget_flag::BATTERY | budget_flag::CHARGE,
                drawn_uj: 7_200_000_000,
                soc: 0.5,
                ..Budget::default()
            }),
        }
    }

    fn outlook() -> Outlook {
        Outlook {
            robot: 7,
            flags: outlook_flag::ENERGY,
            bounded: 2,
            energy_j: [4.0, 40.0, 240.0, 1_200.0],
            energy_lo_j: [3.0, 30.0, f32::NAN, f32::NAN],
            energy_hi_j: [5.0, 50.0, f32::NAN, f32::NAN],
            ..Outlook::default()
        }
    }

    #[test]
    fn every_value_exists_and_those_of_documents_are_among_them() {
        let values = values((7, "r7"), &newest(), Some(&outlook()), |at_ns| at_ns + 1_000);
        for name in value_names() {
            assert!(values.contains_key(name), "{name}");
        }
        for what in [What::Forecast, What::Budget, What::Outlook, What::Alarms] {
            for name in what.usual() {
                assert!(value_names().any(|value| value == name), "{name}");
            }
        }
        assert_eq!(
            (&values["stamp_unix_ns"], &values["target_unix_ns"]),
            (&json!(1_100), &json!(1_130))
        );
        assert_eq!((&values["reading_age_s"], &values["quality"]), (&json!(0.5), &json!("Held")));
        assert_eq!(
            (&values["energy_10s_j"], &values["energy_10s_hi_j"]),
            (&json!(40.0), &json!(50.0))
        );
        assert_eq!(
            (&values["energy_60s_j"], &values["energy_60s_hi_j"]),
            (&json!(240.0), &Value::Null)
        );
        assert_eq!((&values["lo_w"], &values["alarms"]), (&Value::Null, &json!(["StuckSensor"])));
    }

    #[test]
    fn a_document_has_all_values_of_its_kind_and_unknown_ones_are_null() {
        let values = values((7, "r7"), &newest(), None, |at_ns| at_ns);
        let document = document(What::Budget, &values);
        assert_eq!((&document["drawn_j"], &document["soc"]), (&json!(7_200.0), &json!(0.5)));
        assert_eq!((&document["name"], &document["capacity_j"]), (&json!("r7"), &Value::Null));
        assert_eq!(document.as_object().unwrap().len(), What::Budget.usual().count());
    }

    #[test]
    fn a_single_value_is_a_number_and_nan_if_it_is_unknown() {
        let mut values = values((7, "r7"), &newest(), None, |at_ns| at_ns);
        values.insert("charging".to_owned(), json!(true));
        assert_eq!((number("power_w", &values), number("charging", &values)), (4.75, 1.0));
        assert!(number("lo_w", &values).is_nan() && number("energy_1s_j", &values).is_nan());
        for (name, expected) in [("watt", "power_w"), ("name", "is no number")] {
            assert!(check_number(name).unwrap_err().contains(expected), "{name}");
        }
        assert_eq!(check_number("charging"), Ok(()));
    }
}
