//! Values in a JSON document: their positions, units and signs.

use serde_json::Value;

use crate::mapping::account::Reason;
use crate::mapping::observation::{Observation, PowerOf, PowerReading};
use crate::mapping::units::{Quantity, Unit};

/// The position of a value in a document.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ValuePath {
    /// JSON pointer (RFC 6901), empty for the whole document.
    pub(crate) pointer: String,
    /// A second one, for documents without the first.
    pub(crate) or: Option<&'static str>,
    /// Values that mean "not known".
    pub(crate) unknown: Vec<Value>,
}

impl ValuePath {
    /// Parses a pointer (`/battery/power`) or the name of a member (`power`).
    pub(crate) fn at(text: &str) -> Self {
        let pointer = match text {
            "" => String::new(),
            text if text.starts_with('/') => text.to_owned(),
            name => format!("/{}", name.replace('~', "~0")),
        };
        Self { pointer, or: None, unknown: Vec::new() }
    }

    /// Finds the value, unless it is missing, null or means "not known".
    fn find<'v>(&self, document: &'v Value) -> Option<&'v Value> {
        let second = || self.or.and_then(|pointer| document.pointer(pointer));
        let found = document.pointer(&self.pointer).or_else(second)?;
        let is_unknown = found.is_null() || self.unknown.iter().any(|value| is_equal(value, found));
        (!is_unknown).then_some(found)
    }
}

/// True if two values are equal. Numbers are compared by value: −1 equals −1.0.
fn is_equal(one: &Value, other: &Value) -> bool {
    one == other || one.as_f64().is_some_and(|one| other.as_f64() == Some(one))
}

/// Position, unit and sign of a number.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Number {
    pub(crate) path: ValuePath,
    pub(crate) unit: Unit,
    /// The other system counts the opposite direction as positive.
    pub(crate) negate: bool,
}

impl Number {
    /// A number at `path` in the SI unit.
    pub(crate) fn si(quantity: Quantity, path: &str) -> Self {
        Self { path: ValuePath::at(path), unit: quantity.si(), negate: false }
    }

    /// Reads the value in SI.
    fn read(&self, document: &Value) -> Result<Option<f32>, Reason> {
        let Some(found) = self.path.find(document) else {
            return Ok(None);
        };
        let number = found.as_f64().ok_or(Reason::WrongType)? * self.unit.size;
        let number = (if self.negate { -number } else { number }) as f32;
        if number.is_finite() { Ok(Some(number)) } else { Err(Reason::NotFinite) }
    }
}

/// The position of a truth value, and the values that mean yes.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Flag {
    pub(crate) path: ValuePath,
    /// If given, every other value of its type means no.
    pub(crate) is: Vec<Value>,
}

impl Flag {
    /// A boolean at `path`.
    pub(crate) fn at(path: &str) -> Self {
        Self { path: ValuePath::at(path), is: vec![Value::Bool(true)] }
    }

    fn read(&self, document: &Value) -> Result<Option<bool>, Reason> {
        let Some(found) = self.path.find(document) else {
            return Ok(None);
        };
        if self.is.iter().any(|value| is_equal(value, found)) {
            return Ok(Some(true));
        }
        let kind = std::mem::discriminant(found);
        let is_alike = self.is.iter().any(|value| std::mem::discriminant(value) == kind);
        if is_alike { Ok(Some(false)) } else { Err(Reason::WrongType) }
    }
}

/// The values of a document, with their paths in it.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Fields {
    pub(crate) v: Option<Number>,
    /// Velocity across the direction of driving. The speed then counts.
    pub(crate) vy: Option<Number>,
    pub(crate) omega: Option<Number>,
    pub(crate) power: Option<Number>,
    /// The flow that `power` measures.
    pub(crate) power_of: PowerOf,
    /// Without `power`, voltage times current is the battery's power.
    pub(crate) power_of_current: bool,
    pub(crate) voltage: Option<Number>,
    pub(crate) current: Option<Number>,
    pub(crate) soc: Option<Number>,
    pub(crate) charging: Option<Flag>,
    pub(crate) full: Option<Flag>,
    /// Position of the robot's name, unless the topic has it.
    pub(crate) robot: Option<ValuePath>,
    /// The standard of the documents, if they have one.
    pub(crate) standard: Option<Standard>,
}

/// A standard whose version documents state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Standard {
    /// VDA 5050. Its vehicles may leave out everything but the state of charge and whether they
    /// are charging.
    Vda5050,
}

impl Standard {
    /// The version that the document states, unless it is one that is known: 1 to 3.
    pub(crate) fn unknown_version(self, document: &Value) -> Option<String> {
        let Self::Vda5050 = self;
        let version = document.get("version")?;
        let known = version.as_str().is_some_and(|text| {
            let major = text.split('.').next().unwrap_or_default();
            ["1", "2", "3"].contains(&major)
        });
        (!known).then(|| version.to_string())
    }

    /// True if the documents must have the field of this name.
    fn demands(self, name: &str) -> bool {
        let Self::Vda5050 = self;
        matches!(name, "soc" | "charging")
    }
}

/// States of charge that the worker takes.
pub(crate) const SOC: std::ops::RangeInclusive<f32> = -0.05..=1.05;

impl Fields {
    /// Reads the values of a document. An unusable value is passed to `refused` with its name, and
    /// the others count.
    pub(crate) fn read(
        &self,
        document: &Value,
        mut refused: impl FnMut(Reason, &'static str),
    ) -> Observation {
        let mut number = |field: &Option<Number>, name| {
            let read = field.as_ref().map_or(Ok(None), |field| field.read(document));
            read.unwrap_or_else(|reason| {
                refused(reason, name);
                None
            })
        };
        let mut seen = Observation {
            v_mps: number(&self.v, "v"),
            omega_radps: number(&self.omega, "omega"),
            voltage_v: number(&self.voltage, "voltage"),
            current_a: number(&self.current, "current"),
            soc: number(&self.soc, "soc"),
            ..Observation::default()
        };
        // As ROS and VDA 5050 write a charge that is not measured, in whatever unit.
        let unknown = self.soc.as_ref().map(|soc| -soc.unit.size as f32);
        let is_unknown = seen.soc.is_some() && seen.soc == unknown;
        seen.soc = seen.soc.filter(|_| !is_unknown);
        // It is judged with the others of its robot, and in no sample.
        let is_odd = seen.soc.is_some_and(|soc| !SOC.contains(&soc));
        if let Some(vy_mps) = number(&self.vy, "vy").filter(|vy_mps| *vy_mps != 0.0) {
            let speed_mps = seen.v_mps.map(|v_mps| v_mps.hypot(vy_mps));
            seen.v_mps = speed_mps.filter(|speed_mps| speed_mps.is_finite());
        }
        let power_w = number(&self.power, "power");
        seen.power = power_w.map(|power_w| PowerReading { power_w, of: self.power_of });
        if self.power_of_current {
            seen.power_of_current = seen.power.is_none();
            seen.power = seen.power.or(product(seen.voltage_v, seen.current_a));
        }
        let mut flag = |field: &Option<Flag>, name| {
            let read = field.as_ref().map_or(Ok(None), |field| field.read(document));
            read.unwrap_or_else(|reason| {
                refused(reason, name);
                None
            })
        };
        seen.charging = flag(&self.charging, "charging");
        seen.reports_charging = self.charging.is_some();
        seen.full = flag(&self.full, "full");
        if is_odd {
            refused(Reason::OutOfRange, "soc");
        }
        if is_unknown {
            refused(Reason::Unknown, "soc");
        }
        seen
    }

    /// The fields that the mapping names, and whether a message had them.
    pub(crate) fn came(&self, seen: &Observation) -> Vec<(&'static str, bool)> {
        let power = self.power.is_some() || self.power_of_current;
        let fields = [
            ("v", self.v.is_some(), seen.v_mps.is_some()),
            ("omega", self.omega.is_some(), seen.omega_radps.is_some()),
            ("power", power, seen.power.is_some()),
            ("voltage", self.voltage.is_some(), seen.voltage_v.is_some()),
            ("current", self.current.is_some(), seen.current_a.is_some()),
            ("soc", self.soc.is_some(), seen.soc.is_some()),
            ("charging", self.charging.is_some(), seen.charging.is_some()),
            ("full", self.full.is_some(), seen.full.is_some()),
        ];
        let is_due = |name| self.standard.is_none_or(|standard| standard.demands(name));
        let named = fields.into_iter().filter(|(name, is_named, _)| *is_named && is_due(name));
        named.map(|(name, _, has)| (name, has)).collect()
    }

    /// The robot's name in the document: a text or an integer.
    pub(crate) fn robot(&self, document: &Value) -> Option<String> {
        match self.robot.as_ref()?.find(document)? {
            Value::String(name) => Some(name.clone()),
            Value::Number(number) => Some(number.as_u64()?.to_string()),
            _ => None,
        }
    }

    /// Fields of a vehicle's `state` by VDA 5050: battery, and velocity in the vehicle's frame. Up
    /// to version 2 the battery is `batteryState`, from 3 on `powerSupply`, with a current whose
    /// sign the standard does not state: `negate` turns it.
    pub(crate) fn vda5050(negate: bool) -> Self {
        let percent = Unit { name: "%", size: 0.01 };
        let either = |quantity: Quantity, pointer, or| {
            let mut number = Number::si(quantity, pointer);
            number.path.or = Some(or);
            number
        };
        let soc =
            either(Quantity::Share, "/batteryState/batteryCharge", "/powerSupply/stateOfCharge");
        let voltage = "/batteryState/batteryVoltage";
        let mut charging = Flag::at("/batteryState/charging");
        charging.path.or = Some("/powerSupply/charging");
        Self {
            v: Some(Number::si(Quantity::Speed, "/velocity/vx")),
            vy: Some(Number::si(Quantity::Speed, "/velocity/vy")),
            omega: Some(Number::si(Quantity::TurnRate, "/velocity/omega")),
            soc: Some(Number { unit: percent, ..soc }),
            voltage: Some(either(Quantity::Voltage, voltage, "/powerSupply/batteryVoltage")),
            current: Some(Number {
                negate,
                ..Number::si(Quantity::Current, "/powerSupply/batteryCurrent")
            }),
            power_of_current: true,
            charging: Some(charging),
            standard: Some(Standard::Vda5050),
            ..Self::default()
        }
    }
}

/// The battery's power, if both factors are numbers.
pub(crate) fn product(voltage_v: Option<f32>, current_a: Option<f32>) -> Option<PowerReading> {
    let power_w = voltage_v? * current_a?;
    power_w.is_finite().then_some(PowerReading { power_w, of: PowerOf::Battery })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use serde_json::json;

    use super::*;

    fn number(path: &str, quantity: Quantity, unit: &str, negate: bool) -> Option<Number> {
        Some(Number { path: ValuePath::at(path), unit: quantity.unit(unit).unwrap(), negate })
    }

    fn fields() -> Fields {
        Fields {
            power: number("/battery/power", Quantity::Power, "mW", false),
            current: number("/battery/current", Quantity::Current, "mA", true),
            voltage: number("volt", Quantity::Voltage, "V", false),
            soc: number("/soc", Quantity::Share, "%", false),
            charging: Some(Flag { is: vec![json!("charging"), json!(1)], ..Flag::at("/state") }),
            power_of_current: true,
            ..Fields::default()
        }
    }

    fn read(fields: &Fields, document: &Value) -> (Observation, Vec<(Reason, &'static str)>) {
        let mut refused = Vec::new();
        let seen = fields.read(document, |reason, name| refused.push((reason, name)));
        (seen, refused)
    }

    #[test]
    fn values_have_units_and_signs() {
        let document = json!({
            "battery": {"power": 4600, "current": -383.0}, "volt": 12, "soc": 50.0, "state": "charging",
        });
        let (seen, refused) = read(&fields(), &document);
        assert_eq!(refused, []);
        assert_eq!(seen.power.unwrap().power_w, 4.6);
        assert_eq!(
            (seen.current_a, seen.voltage_v, seen.soc),
            (Some(0.383), Some(12.0), Some(0.5))
        );
        assert_eq!(seen.charging, Some(true));
        let product = json!({"battery": {"current": -500}, "volt": 12, "state": 0});
        let (seen, _) = read(&fields(), &product);
        let power = seen.power.unwrap();
        assert_eq!((power.power_w, power.of), (6.0, PowerOf::Battery));
        assert_eq!(seen.charging, Some(false));
    }

    #[test]
    fn what_is_missing_null_or_a_sentinel_is_unknown_and_no_error() {
        let mut fields = fields();
        for number in [&mut fields.power, &mut fields.voltage].into_iter().flatten() {
            number.path.unknown = vec![json!(-1)];
        }
        for document in [
            json!({}),
            json!([]),
            json!(7),
            json!({"battery": null, "volt": null, "state": null}),
            json!({"battery": {"power": -1.0}, "volt": -1}),
        ] {
            let (seen, refused) = read(&fields, &document);
            assert!(seen.is_empty() && refused.is_empty(), "{document}: {seen:?} {refused:?}");
        }
    }

    #[test]
    fn a_wrong_value_is_named_and_the_others_are_taken() {
        for (power, expected) in [
            (json!("4600"), Reason::WrongType),
            (json!([4600]), Reason::WrongType),
            (json!({"w": 4}), Reason::WrongType),
            (json!(true), Reason::WrongType),
            (json!(1e300), Reason::NotFinite),
        ] {
            let document = json!({"battery": {"power": power}, "soc": 50, "state": []});
            let (seen, refused) = read(&fields(), &document);
            assert_eq!(refused, [(expected, "power"), (Reason::WrongType, "charging")]);
            assert_eq!((seen.power, seen.soc), (None, Some(0.5)));
        }
        let overflow = json!({"battery": {"current": -1e38}, "volt": 1e38});
        assert_eq!(read(&fields(), &overflow).0.power, None, "their product is not finite");
    }

    #[test]
    fn a_vehicles_state_by_vda_5050_is_read() {
        let document = json!({
            "headerId": 1, "version": "2.0.0", "manufacturer": "KIT", "serialNumber": "0001", "driving": true,
            "velocity": {"vx": 0.3, "vy": 0.4, "omega": -0.2},
            "batteryState": {"batteryCharge": 80.0, "batteryVoltage": 24.5, "charging": false, "reach": 1200},
        });
        let fields =
            Fields { robot: Some(ValuePath::at("/serialNumber")), ..Fields::vda5050(true) };
        let (seen, refused) = read(&fields, &document);
        assert_eq!(refused, []);
        assert_eq!((seen.v_mps, seen.omega_radps), (Some(0.5), Some(-0.2)));
        assert_eq!((seen.soc, seen.voltage_v, seen.charging), (Some(0.8), Some(24.5), Some(false)));
        assert_eq!(seen.power, None, "version 2 has neither power nor current");
        let of_3 = json!({
            "version": "3.0.0", "velocity": {"vx": 0.5}, "powerSupply": {
                "stateOfCharge": 61.5, "batteryVoltage": 24.0, "batteryCurrent": -2.0, "charging": true,
            },
        });
        let (new, refused) = read(&fields, &of_3);
        assert_eq!(refused, []);
        assert_eq!(new.power.map(|power| power.power_w), Some(48.0));
        assert_eq!((new.soc, new.voltage_v, new.charging), (Some(0.615), Some(24.0), Some(true)));
        let unknown = |document| Standard::Vda5050.unknown_version(&document);
        for known in ["1.1", "2.0.0", "2.1.0", "3.0.0", "3.1"] {
            assert_eq!(unknown(json!({"version": known})), None, "{known}");
        }
        assert_eq!(unknown(json!({})), None);
        assert_eq!(unknown(json!({"version": "4.0.0"})).as_deref(), Some("\"4.0.0\""));
        assert_eq!(unknown(json!({"version": 3})).as_deref(), Some("3"));
        assert_eq!(fields.robot(&document).as_deref(), Some("0001"));
        assert_eq!(fields.robot(&json!({"serialNumber": 7})).as_deref(), Some("7"));
        assert_eq!(fields.robot(&json!({"serialNumber": -7.5})), None);
        let backwards = json!({"velocity": {"vx": -0.3, "vy": 0.0}});
        assert_eq!(read(&fields, &backwards).0.v_mps, Some(-0.3));
    }

    fn any_json() -> impl Strategy<Value = Value> {
        let leaf = prop_oneof![
            Just(Value::Null),
            any::<bool>().prop_map(Value::Bool),
            any::<f64>().prop_map(|number| json!(number)),
            any::<i64>().prop_map(|number| json!(number)),
            "[a-z]{0,6}".prop_map(Value::String),
        ];
        leaf.prop_recursive(4, 32, 4, |inner| {
            let name = prop_oneof![
                Just("battery"),
                Just("power"),
                Just("current"),
                Just("volt"),
                Just("soc"),
                Just("state"),
            ];
            let name = name.prop_map(str::to_owned);
            prop_oneof![
                prop::collection::vec(inner.clone(), 0..4).prop_map(Value::Array),
                prop::collection::hash_map(name, inner, 0..4)
                    .prop_map(|members| Value::Object(members.into_iter().collect())),
            ]
        })
    }

    proptest! {
        #[test]
        fn no_document_panics_or_gives_a_number_that_is_not_finite(document in any_json()) {
            let (seen, _) = read(&fields(), &document);
            let power_w = seen.power.map(|power| power.power_w);
            for number in [power_w, seen.voltage_v, seen.current_a, seen.soc].into_iter().flatten() {
                prop_assert!(number.is_finite());
            }
        }
    }
}
