//! Values in a JSON document: their positions, units and signs.

use joulebus_plausibility::moment::{self, TimeForm};
use joulebus_plausibility::{Field, Quantity as Judged, Said};
use serde_json::Value;

use crate::mapping::account::Reason;
use crate::mapping::observation::{Observation, PowerOf};
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
    pub(crate) fn si(quantity: Quantity, path: &str) -> Self {
        Self { path: ValuePath::at(path), unit: quantity.si(), negate: false }
    }

    /// Reads the value in SI, that of a charge in its own unit.
    fn read(&self, document: &Value) -> Result<Option<f64>, Reason> {
        let Some(found) = self.path.find(document) else {
            return Ok(None);
        };
        let number = found.as_f64().ok_or(Reason::WrongType)?;
        let number = if self.unit.measures_share() { number } else { number * self.unit.size };
        Ok(Some(if self.negate { -number } else { number }))
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
    /// Whether the robot is gone.
    pub(crate) ended: Option<Flag>,
    pub(crate) swapped: Option<Flag>,
    pub(crate) off: Option<Flag>,
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

    /// Seconds by which the time in a document differs from its arrival, if they are more than
    /// clocks and networks explain.
    pub(crate) fn age_s(self, document: &Value, unix_s: f64) -> Option<f64> {
        let Self::Vda5050 = self;
        let text = document.get("timestamp")?.as_str()?;
        let (_, made_s) = moment::parse(text, None).filter(|(form, _)| *form == TimeForm::Date)?;
        Some(unix_s - made_s).filter(|age_s| age_s.abs() > MAX_AGE_S)
    }

    /// True if the documents must have the field of this name.
    fn demands(self, name: &str) -> bool {
        let Self::Vda5050 = self;
        matches!(name, "soc" | "charging")
    }
}

/// Age of a message at its arrival that is no news, s.
const MAX_AGE_S: f64 = 5.0;

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
        let mut said = Said {
            power_of: self.power_of,
            product_of: self.power_of_current.then_some(PowerOf::Battery),
            ..Said::default()
        };
        for (field, number) in self.numbers() {
            match number.read(document) {
                Ok(Some(value)) => said.set(field, value),
                Ok(None) => {}
                Err(reason) => refused(reason, name(field)),
            }
        }
        // As ROS and VDA 5050 write a charge that is not measured, in whatever unit.
        if let Some(soc) = &self.soc {
            said.soc_unit = soc.unit.size;
        }
        let mut flag = |field: &Option<Flag>, name| {
            let read = field.as_ref().map_or(Ok(None), |field| field.read(document));
            read.unwrap_or_else(|reason| {
                refused(reason, name);
                None
            })
        };
        said.charging = flag(&self.charging, "charging");
        said.full = flag(&self.full, "full");
        let (swapped, off) = (flag(&self.swapped, "swapped"), flag(&self.off, "off"));
        let has_ended = flag(&self.ended, "ended") == Some(true);
        let mapped = said.map(|field, why| refused(why.into(), name(field)));
        let reports_charging = self.charging.is_some();
        Observation { swapped, off, reports_charging, has_ended, ..Observation::of(&mapped) }
    }

    /// The numbers that the mapping names.
    fn numbers(&self) -> impl Iterator<Item = (Field, &Number)> {
        let all = [
            (Field::V, &self.v),
            (Field::Omega, &self.omega),
            (Field::Voltage, &self.voltage),
            (Field::Current, &self.current),
            (Field::Soc, &self.soc),
            (Field::Vy, &self.vy),
            (Field::Power, &self.power),
        ];
        all.into_iter().filter_map(|(field, number)| Some((field, number.as_ref()?)))
    }

    /// What the mapping calls the quantities that are judged, with their units. A standard has its
    /// own.
    pub(crate) fn named(&self) -> Vec<(Judged, String)> {
        let is_own = |_: &(Field, &Number)| self.standard.is_none();
        let named = self.numbers().filter(is_own).filter_map(|(field, number)| {
            let quantity = Judged::ALL.into_iter().find(|one| one.name() == name(field))?;
            Some((quantity, format!("{}_{}", quantity.name(), number.unit.name)))
        });
        named.collect()
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

    /// True if messages may tell nothing: those that say whether the robot is gone.
    pub(crate) const fn may_be_empty(&self) -> bool {
        self.off.is_some() || self.ended.is_some()
    }

    /// The robot's name in the document: a text or an integer.
    pub(crate) fn robot(&self, document: &Value) -> Option<String> {
        match self.robot.as_ref()?.find(document)? {
            Value::String(name) => Some(name.clone()),
            Value::Number(number) => Some(number.as_u64()?.to_string()),
            _ => None,
        }
    }

    /// Fields of a vehicle's `connection` by VDA 5050: whether it is gone. Only `OFFLINE` is its own
    /// word, that it is switched off. The broker writes the others in its place.
    pub(crate) fn vda5050_connection() -> Self {
        let is = ["CONNECTIONBROKEN", "CONNECTION_BROKEN"].map(Value::from).to_vec();
        let off = Flag { is: vec!["OFFLINE".into()], ..Flag::at("/connectionState") };
        Self {
            off: Some(off),
            ended: Some(Flag { is, ..Flag::at("/connectionState") }),
            standard: Some(Standard::Vda5050),
            ..Self::default()
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

/// Ends of the topic of a vehicle's state, and of that by which its broker says that it is gone.
const STATE: &str = "/state";
const CONNECTION: &str = "/connection";

/// The topic of a vehicle's connection beside that of its state, by VDA 5050.
pub(crate) fn connection_topic(state: &str) -> Option<String> {
    Some(state.strip_suffix(STATE)?.to_owned() + CONNECTION)
}

/// The name of a field in a mapping.
const fn name(field: Field) -> &'static str {
    match field {
        Field::V | Field::VMeasured => "v",
        Field::Vy | Field::VyMeasured => "vy",
        Field::Omega | Field::OmegaMeasured => "omega",
        Field::Power => "power",
        Field::Voltage => "voltage",
        Field::Current => "current",
        Field::Soc => "soc",
    }
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
            assert_eq!(refused.len(), 2);
            for one in [(expected, "power"), (Reason::WrongType, "charging")] {
                assert!(refused.contains(&one), "{refused:?}");
            }
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
