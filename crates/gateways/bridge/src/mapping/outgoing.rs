//! JSON documents about robots: a mapping of values to names, units and signs.

use joulebus_board::{Newest, RobotRecord};
use joulebus_consumer::wire::{OUTLOOK_S, Outlook};
use serde_json::{Map, Value, json};

use crate::mapping::units::{Quantity, Unit};

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

    /// The values of a document without a mapping of its own.
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

/// All values of a robot, for use in mappings.
const VALUES: [(Quantity, &str); 15] = [
    (Quantity::Plain, "robot name quality quality_detail stamp_unix_ns target_unix_ns"),
    (Quantity::Power, "reading_w"),
    (Quantity::Time, "reading_age_s"),
    (Quantity::Power, "power_w lo_w hi_w residual_w bias_w"),
    (Quantity::Plain, "level alarms"),
    (Quantity::Energy, "drawn_j"),
    (Quantity::Time, "metered_s unmetered_s"),
    (Quantity::Power, "mean_power_w"),
    (Quantity::Share, "soc soc_lo soc_hi"),
    (Quantity::Plain, "charging"),
    (Quantity::Energy, "usable_j usable_lo_j"),
    (Quantity::Time, "time_to_empty_s time_to_empty_lo_s time_to_empty_hi_s"),
    (Quantity::Energy, "capacity_j capacity_sd_j"),
    (Quantity::Time, "time_to_80_s time_to_full_s"),
    (
        Quantity::Energy,
        "energy_1s_j energy_1s_lo_j energy_1s_hi_j energy_10s_j energy_10s_lo_j \
         energy_10s_hi_j energy_60s_j energy_60s_lo_j energy_60s_hi_j energy_300s_j \
         energy_300s_lo_j energy_300s_hi_j",
    ),
];

/// True if the value `name` is of an outlook, which the worker computes only for readers.
pub(crate) fn is_of_outlook(name: &str) -> bool {
    name.starts_with("energy_")
}

/// The quantity of the value `name`. `None` if there is no such value.
pub(crate) fn quantity(name: &str) -> Option<Quantity> {
    let is_of = |names: &str| names.split(' ').any(|value| value == name);
    VALUES.into_iter().find(|(_, names)| is_of(names)).map(|(quantity, _)| quantity)
}

pub(crate) fn value_names() -> impl Iterator<Item = &'static str> {
    VALUES.into_iter().flat_map(|(_, names)| names.split(' '))
}

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct OutgoingValue {
    pub(crate) value: String,
    pub(crate) path: Vec<String>,
    pub(crate) unit: Unit,
    pub(crate) negate: bool,
}

impl OutgoingValue {
    pub(crate) fn plain(value: &str) -> Self {
        Self {
            value: value.to_owned(),
            path: vec![value.to_owned()],
            unit: quantity(value).unwrap_or(Quantity::Plain).si(),
            negate: false,
        }
    }

    fn of(&self, values: &Object) -> Value {
        let value = values.get(&self.value).unwrap_or(&Value::Null);
        let is_plain = self.unit.size == 1.0 && !self.negate;
        match self.number(values) {
            Some(number) if !is_plain && value.is_number() => json!(number),
            _ => value.clone(),
        }
    }

    /// The value in its unit and with its sign. A boolean is 1 or 0. `None` if it is unknown or no
    /// number.
    pub(crate) fn number(&self, values: &Object) -> Option<f64> {
        let number = match values.get(&self.value)? {
            Value::Bool(is_true) => f64::from(u8::from(*is_true)),
            value => value.as_f64()? / self.unit.size,
        };
        Some(if self.negate { -number } else { number })
    }
}

/// The document with these values. Unknown ones are null.
pub(crate) fn document(fields: &[OutgoingValue], values: &Object) -> Value {
    let mut document = Object::new();
    for field in fields {
        insert(&mut document, &field.path, field.of(values));
    }
    Value::Object(document)
}

fn insert(object: &mut Object, path: &[String], value: Value) {
    match path {
        [] => {}
        [name] => {
            object.insert(name.clone(), value);
        }
        [name, rest @ ..] => {
            let inner = object.entry(name.clone()).or_insert_with(|| json!({}));
            if let Value::Object(inner) = inner {
                insert(inner, rest, value);
            }
        }
    }
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
    fn every_value_that_a_mapping_may_name_exists_and_usual_ones_are_among_them() {
        let values = values((7, "r7"), &newest(), Some(&outlook()), |at_ns| at_ns + 1_000);
        for name in value_names() {
            assert!(values.contains_key(name), "{name}");
        }
        for what in [What::Forecast, What::Budget, What::Outlook, What::Alarms] {
            for name in what.usual() {
                assert!(quantity(name).is_some(), "{name}");
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
    fn a_mapping_sets_names_units_and_signs() {
        let values = values((7, "r7"), &newest(), None, |at_ns| at_ns);
        let field = |value: &str, path: &[&str], unit: &str, negate| OutgoingValue {
            value: value.to_owned(),
            path: path.iter().map(|part| (*part).to_owned()).collect(),
            unit: quantity(value).unwrap().unit(unit).unwrap(),
            negate,
        };
        let fields = [
            field("power_w", &["next", "mw"], "mW", false),
            field("reading_w", &["next", "drawn"], "W", true),
            field("soc", &["charge"], "%", false),
            field("drawn_j", &["wh"], "Wh", false),
            field("lo_w", &["lo"], "W", true),
            OutgoingValue::plain("name"),
        ];
        assert_eq!(
            document(&fields, &values),
            json!({
                "next": {"mw": 4_750.0, "drawn": -4.5}, "charge": 50.0, "wh": 2.0, "lo": null, "name": "r7",
            })
        );
    }
}
