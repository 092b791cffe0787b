//! Findings: the found value, the allowed values, and the remedy.

use std::fmt;
use std::str::FromStr;

use serde::Serialize;

use crate::observation::Observation;
use crate::quantity::{Quantity, UNMEASURED_A, number};

/// Kind of a finding. Its name is what `--accept` takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Kind {
    /// Power or current is negative while the battery discharges.
    Sign,
    /// Values are in another unit or scale.
    Unit,
    /// Times go back, stand still, or are too coarse for the rate.
    Clock,
    /// A command applies long after its controller fell silent.
    Hold,
    /// A quantity that was expected never came.
    NeverCame,
    /// Values outside the allowed range.
    Range,
    /// A sensor at the end of its range, or with a register that wraps.
    Saturation,
    /// A value that never changes.
    Constant,
    /// A number that means that there is no reading.
    Sentinel,
    /// Power differs from voltage times current.
    Mismatch,
    /// Readings of two sources in turn.
    Sources,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 11] = [
        Self::Sign,
        Self::Unit,
        Self::Clock,
        Self::Hold,
        Self::NeverCame,
        Self::Range,
        Self::Saturation,
        Self::Constant,
        Self::Sentinel,
        Self::Mismatch,
        Self::Sources,
    ];

    /// The name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Sign => "sign",
            Self::Unit => "unit",
            Self::Clock => "clock",
            Self::Hold => "hold",
            Self::NeverCame => "never-came",
            Self::Range => "range",
            Self::Saturation => "saturation",
            Self::Constant => "constant",
            Self::Sentinel => "sentinel",
            Self::Mismatch => "mismatch",
            Self::Sources => "sources",
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(self.name())
    }
}

impl FromStr for Kind {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let named = Self::ALL.into_iter().find(|kind| kind.name() == text);
        named.ok_or_else(|| {
            let allowed = Self::ALL.map(Self::name).join(", ");
            format!("{text:?} is no finding, allowed are {allowed}")
        })
    }
}

/// Effect of a finding on a verb.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Severity {
    /// Results would be wrong: a verb stops.
    Error,
    /// Results may be wrong: it is shown.
    Warning,
}

/// Origin of readings: each has its own remedies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// A table, an archive or a capture, read by a verb of joulebus.
    Recording,
    /// A recording whose current is turned already.
    TurnedRecording,
    /// An array, whose columns and units are fixed.
    Array,
    /// A bag, read by `joulebus import`.
    Bag,
    /// A bridge's file.
    Bridge,
    /// A program that publishes by itself.
    Program,
}

/// The remedy of a finding.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Remedy {
    /// Turn the sign of power and current.
    Turn,
    /// State the unit.
    State(&'static str),
    /// State another unit: so many thousands of the one in which it was read, or so many. 0: none.
    Scale { read: &'static str, thousands: [i8; 2] },
    /// Give time in the right unit, by its name in `--map`.
    Seconds(&'static str),
    /// Record or use a better clock.
    Clock,
    /// Let commands expire.
    Expire,
    /// Name another column, topic or pointer.
    Name,
    /// Look at the sensor.
    Sensor,
    /// Correct the values, or their limits.
    Limits,
    /// State which number stands for no reading: as its file has it, and in SI units.
    Missing { written: f64, value: f64 },
    /// Measure the current, which always has this value in SI.
    Unmeasured(f64),
    /// Divide the recording.
    Split,
    /// Name columns that belong together.
    Agree,
    /// Record what is counted.
    Counter,
    /// Tell the sources apart.
    Apart,
    /// Read a column.
    Read,
}

/// An edit of the mapping of a recording, which may remedy a finding.
#[derive(Debug, Clone, PartialEq)]
pub enum Edit {
    /// Turn the sign of the current, and of a power that has its sign.
    Turn,
    /// Read a quantity in another unit, in which its values are so many times as large.
    Unit {
        /// The quantity.
        quantity: Quantity,
        /// The unit, as a mapping names it.
        unit: String,
        /// The factor.
        factor: f64,
    },
    /// Read the time in another unit.
    Time {
        /// The unit, as a mapping names it.
        unit: &'static str,
        /// Its size, s.
        unit_s: f64,
    },
    /// A number stands for no reading.
    Missing {
        /// The quantity that has it.
        quantity: Quantity,
        /// The number as the file has it, and in SI units.
        written: f64,
        /// In SI units, with the sign of joulebus.
        value: f64,
    },
}

impl Edit {
    /// Applies it to an observation. `turns_power`: power has the sign of the current. `is_product`:
    /// power is voltage times current.
    pub fn apply(&self, seen: &mut Observation, turns_power: bool, is_product: bool) {
        match self {
            Self::Turn => {
                seen.current_a = -seen.current_a;
                if turns_power {
                    seen.power_w = -seen.power_w;
                }
            }
            Self::Unit { quantity, factor, .. } => *seen.value_mut(*quantity) *= factor,
            Self::Time { unit_s, .. } => seen.time_s *= unit_s,
            Self::Missing { quantity, value, .. } => {
                let found = seen.value_mut(*quantity);
                if (*found - value).abs() <= 1e-6 * value.abs() {
                    *found = f64::NAN;
                }
            }
        }
        if is_product {
            seen.power_w = seen.voltage_v * seen.current_a;
        }
    }

    /// The options that say it of a recording. `column`: the name of the quantity's column.
    fn option(&self, source: Source, column: &str) -> String {
        let quoted = |text: String| match text.contains(|letter: char| letter.is_whitespace()) {
            true => format!("'{text}'"),
            false => text,
        };
        match self {
            Self::Turn if source == Source::TurnedRecording => {
                "--current discharge-positive".to_owned()
            }
            Self::Turn => "--current discharge-negative".to_owned(),
            Self::Unit { quantity, unit, .. } => {
                format!("--map {}", quoted(format!("{}_{unit}={column}", quantity.name())))
            }
            Self::Time { unit, .. } => format!("--map {}", quoted(format!("time_{unit}={column}"))),
            Self::Missing { written, .. } => format!("--map missing:={written}"),
        }
    }
}

/// A finding about one robot.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// The kind.
    pub kind: Kind,
    /// The quantity. `None` for the clock.
    pub quantity: Option<Quantity>,
    /// Effect of the finding on a verb.
    pub severity: Severity,
    /// Number of readings that show it.
    pub readings: u64,
    /// The found value, in words.
    pub found: String,
    /// The allowed values, in words.
    pub allowed: String,
    #[serde(skip)]
    pub(crate) remedy: Remedy,
}

impl Finding {
    /// In a row of a file, another recording begins: there the time goes back by so much, s, or the
    /// header comes again.
    #[must_use]
    pub fn appended(row: usize, back_s: Option<f64>) -> Self {
        let what = match back_s {
            Some(back_s) => format!("the time goes back by {} s", number(back_s)),
            None => "the header comes again".to_owned(),
        };
        Self {
            kind: Kind::Clock,
            quantity: None,
            severity: Severity::Warning,
            readings: 1,
            found: format!("{what} in row {row}. The rows from there on are another trial"),
            allowed: "a file has one recording".to_owned(),
            remedy: Remedy::Split,
        }
    }

    /// A column looks like a command, and is not read: `option` reads it.
    #[must_use]
    pub fn unread(column: &str, option: &str, rows: u64) -> Self {
        Self {
            kind: Kind::NeverCame,
            quantity: Some(Quantity::V),
            severity: Severity::Warning,
            readings: rows,
            found: format!(
                "column {column} looks like a command and is not read. Forecasts are better with it"
            ),
            allowed: format!("if it is one, it is read with {option}"),
            remedy: Remedy::Read,
        }
    }

    /// The edits of a recording's mapping that may remedy it, of which one is right. `column` is the
    /// name that the recording has for the quantity.
    #[must_use]
    pub fn edits(&self, column: Option<&str>) -> Vec<Edit> {
        let Some(quantity) = self.quantity else {
            return match self.remedy {
                Remedy::Seconds(unit) => {
                    let sizes =
                        [("ns", 1e-9), ("us", 1e-6), ("ms", 1e-3), ("min", 60.0), ("h", 3.6e3)];
                    let size = sizes.into_iter().find(|(name, _)| *name == unit);
                    vec![Edit::Time { unit, unit_s: size.map_or(86_400.0, |(_, size)| size) }]
                }
                _ => Vec::new(),
            };
        };
        match self.remedy {
            Remedy::Turn => vec![Edit::Turn],
            Remedy::Scale { read, thousands } => {
                let read =
                    column.and_then(|column| stated(quantity.name(), column)).unwrap_or(read);
                let edit = |steps: i8| {
                    let unit = scaled(read, [steps, 0]).pop()?;
                    Some(Edit::Unit { quantity, unit, factor: 1e3_f64.powi(steps.into()) })
                };
                let [first, second] = thousands;
                let several = [Some(first), Some(second).filter(|second| *second != 0)];
                several.into_iter().flatten().filter_map(edit).collect()
            }
            Remedy::State(unit) => {
                let factor = match unit {
                    "percent" | "cmps" => 1e-2,
                    "share" => 1e2,
                    "mmps" => 1e-3,
                    "degps" => std::f64::consts::PI / 180.0,
                    _ => return Vec::new(),
                };
                vec![Edit::Unit { quantity, unit: unit.to_owned(), factor }]
            }
            Remedy::Missing { written, value } if written != 0.0 => {
                vec![Edit::Missing { quantity, written, value }]
            }
            _ => Vec::new(),
        }
    }

    /// The remedy, in the words of the source. `column` is the name that the source has for the
    /// quantity, if known.
    #[must_use]
    pub fn remedy(&self, source: Source, column: Option<&str>) -> String {
        self.remedy_by(source, column, &self.edits(column))
    }

    /// The same with those of its edits that were tried, and leave no finding.
    #[must_use]
    pub fn remedy_by(&self, source: Source, column: Option<&str>, edits: &[Edit]) -> String {
        let quantity = self.quantity.map_or("time", Quantity::name);
        let column = column.unwrap_or("COLUMN");
        let accept = self.kind;
        // The field of a mapping that may make power of the current.
        let field = match self.quantity {
            Some(Quantity::Power) => "power`, or `current",
            _ => quantity,
        };
        let is_recording = matches!(source, Source::Recording | Source::TurnedRecording);
        let takes_option = is_recording
            || (source == Source::Array
                && matches!(self.remedy, Remedy::Turn | Remedy::Missing { .. }));
        let options: Vec<String> = edits.iter().map(|edit| edit.option(source, column)).collect();
        let options = options.join(" or ");
        let remedy = match (self.remedy, source) {
            (Remedy::Turn | Remedy::Scale { .. } | Remedy::State(_) | Remedy::Seconds(_), _)
                if takes_option && edits.is_empty() =>
            {
                format!("correct the values of {column}: no option mends them")
            }
            (Remedy::Turn, _) if takes_option => format!("turn the sign with {options}"),
            (Remedy::Scale { .. } | Remedy::State(_), _) if is_recording => {
                format!("state the unit, {options}, or correct the file")
            }
            (Remedy::Seconds(_), _) if is_recording => {
                format!("state the unit of the time, such as {options}")
            }
            (Remedy::Turn, Source::Recording | Source::TurnedRecording | Source::Array) => {
                "correct the sign".to_owned()
            }
            (Remedy::Turn, Source::Bag) => {
                "state the other sign with --current discharge-positive or discharge-negative"
                    .to_owned()
            }
            (Remedy::Turn, Source::Bridge) => format!(
                "turn the sign: of MQTT with negate = true in the field `{field}`, of ROS 2 and VDA \
                 5050 with the other `current`"
            ),
            (Remedy::Turn, Source::Program) => format!("publish {quantity} with the other sign"),
            (Remedy::Scale { .. } | Remedy::State(_), Source::Array) => format!(
                "convert its {quantity}, because an array has s, m/s, rad/s, mV, mA and mW, or give a \
                 CSV with --map"
            ),
            (
                Remedy::Scale { .. } | Remedy::State(_),
                Source::Recording | Source::TurnedRecording,
            ) => {
                format!("correct the values of {column}, or the unit in its name")
            }
            (Remedy::Scale { thousands: [thousands, _], .. }, Source::Bag) => format!(
                "state the unit in a mapping file, such as {quantity}_unit = {}",
                1e3_f64.powi(thousands.into())
            ),
            (Remedy::State(_), Source::Bag) => {
                format!("state the unit in a mapping file, such as {quantity}_unit = 0.001")
            }
            (Remedy::Scale { thousands, .. }, Source::Bridge) => {
                let si = self.quantity.map_or("", Quantity::unit);
                let fields = fields(quantity, &scaled(si, thousands));
                format!(
                    "state the unit in the field, {fields}. A BatteryState of ROS 2 has V and A: \
                     correct its driver"
                )
            }
            (Remedy::State(unit), Source::Bridge) => {
                // The units of a bridge's file.
                let unit = match unit {
                    "percent" => "%",
                    "cmps" => "cm/s",
                    "mmps" => "mm/s",
                    "degps" => "deg/s",
                    other => other,
                };
                let ros = match quantity {
                    "soc" => ". Of ROS 2, set percentage_unit = \"%\"",
                    _ => "",
                };
                format!(
                    "state the unit in the field, {}{ros}",
                    fields(quantity, &[unit.to_owned()])
                )
            }
            (Remedy::Scale { .. }, Source::Program) => {
                format!("publish {quantity} in {}", self.quantity.map_or("", Quantity::unit))
            }
            (Remedy::State(unit), Source::Program) => {
                format!("publish {quantity} in SI units, not in {unit}")
            }
            (Remedy::Seconds(unit), Source::Array) => {
                format!("convert its time, which seems to be in {unit}, to seconds")
            }
            (Remedy::Seconds(unit), _) => {
                format!("state the unit of the time, such as --map time_{unit}={column}")
            }
            (Remedy::Clock, Source::Bag) => "use the time of recording with --time log".to_owned(),
            (Remedy::Clock, _) => "record times that advance with every row".to_owned(),
            (Remedy::Expire, Source::Bridge) => "set command_holds_s".to_owned(),
            (Remedy::Expire, Source::Bag) => "set command_holds_s in a mapping file".to_owned(),
            (Remedy::Expire, _) => {
                "record what the robot executes, 0 where it stopped by itself".to_owned()
            }
            (Remedy::Name, Source::Recording | Source::TurnedRecording | Source::Array) => {
                format!("name its column with --map {quantity}=COLUMN")
            }
            (Remedy::Name, Source::Bag) => "name its topic in a mapping file".to_owned(),
            (Remedy::Name, Source::Bridge) => {
                "correct its topic or `at` in the bridge's file".to_owned()
            }
            (Remedy::Name, Source::Program) => format!("publish {quantity}"),
            (
                Remedy::Limits,
                Source::Recording | Source::TurnedRecording | Source::Array | Source::Bag,
            ) => "correct the values, or state another platform's limits".to_owned(),
            (Remedy::Limits, _) => "correct the values or the platform's limits".to_owned(),
            // Zero is a speed and a current as well.
            (Remedy::Missing { written: 0.0, .. }, _) => {
                "leave the fields empty where there is no reading".to_owned()
            }
            (Remedy::Missing { .. }, _) if takes_option && !edits.is_empty() => {
                format!("say that it is no reading with {options}")
            }
            (Remedy::Missing { .. }, _) => {
                format!("leave {quantity} out where there is no reading")
            }
            (Remedy::Unmeasured(value), source) => unmeasured(value, source, column),
            (Remedy::Split, _) => "divide the recording where it changes".to_owned(),
            (Remedy::Agree, _) => {
                "name power, voltage and current of one circuit, or leave out the others".to_owned()
            }
            (Remedy::Read, _) => "leave it out where it is none".to_owned(),
            (Remedy::Counter, _) => {
                format!("record the {quantity} itself: an energy (Wh) or a charge (Ah) is not read")
            }
            (Remedy::Apart, Source::Recording | Source::TurnedRecording) if column != "COLUMN" => {
                format!("tell the sources apart, --map robot={column}, or record one of them")
            }
            (Remedy::Apart, Source::Bag | Source::Bridge) => {
                "give each source a topic of its own, or stop one".to_owned()
            }
            (Remedy::Apart, _) => "record one source".to_owned(),
            (Remedy::Sensor, _) => "check the sensor and its driver".to_owned(),
        };
        match source {
            // Accepting it would turn an unknown into a number.
            _ if matches!(self.remedy, Remedy::Unmeasured(_)) => remedy,
            Source::Recording | Source::TurnedRecording | Source::Array | Source::Bag => {
                format!("{remedy}. If it is right, add --accept {accept}")
            }
            Source::Bridge => format!("{remedy}. If it is right, set accept = [\"{accept}\"]"),
            Source::Program => remedy,
        }
    }

    /// The found value, the allowed values and the remedy, a sentence each.
    #[must_use]
    pub fn sentences(&self, remedy: &str) -> String {
        let begun = |text: &str| {
            let mut letters = text.chars();
            let first = letters.next().map(|letter| letter.to_uppercase().to_string());
            first.unwrap_or_default() + letters.as_str()
        };
        let end = if self.found.ends_with('?') { "" } else { "." };
        format!("{}{end} {}. {}.", self.found, begun(&self.allowed), begun(remedy))
    }

    /// True if it stops a verb.
    #[must_use]
    pub fn is_error(&self) -> bool {
        self.severity == Severity::Error
    }
}

/// The remedy of a current that nobody measures: to say so, where its file has a number for that.
fn unmeasured(value: f64, source: Source, column: &str) -> String {
    let sign = if source == Source::TurnedRecording { -1.0 } else { 1.0 };
    let units: &[f64] = match (source, stated("current", column)) {
        (Source::Array, _) | (_, Some("mA")) => &[1e-3],
        (_, Some("A")) => &[1.0],
        (_, Some(_)) => &[1e-6],
        (_, None) => &[1.0, 1e-3],
    };
    let is_reserved =
        units.iter().any(|unit| (sign * value / unit - UNMEASURED_A).abs() < RESERVED_WITHIN);
    let say = match source {
        Source::Recording | Source::TurnedRecording | Source::Array if is_reserved => {
            "say that it is no reading with --map missing:=-1"
        }
        Source::Bridge => "leave the current out of the mapping",
        Source::Program => "publish no current, and no power made of it",
        _ => "use a recording of another monitor",
    };
    format!("check the sensor and its driver, or {say}")
}

/// Rounding of a number that is converted to SI, and of 32 bits.
const RESERVED_WITHIN: f64 = 1e-6;

/// Units of power, voltage and current, in steps of a thousand.
const UNITS: [(&str, [&str; 4]); 3] = [
    ("power", ["uW", "mW", "W", "kW"]),
    ("voltage", ["uV", "mV", "V", ""]),
    ("current", ["uA", "mA", "A", ""]),
];

/// The unit that the name of a column states.
fn stated(quantity: &str, column: &str) -> Option<&'static str> {
    let (_, units) = UNITS.iter().find(|(of, _)| *of == quantity)?;
    let parts: Vec<&str> = column.split(|letter: char| !letter.is_alphanumeric()).collect();
    let last = parts.iter().skip(1).rev().find(|part| !part.is_empty())?;
    units.iter().find(|unit| unit.eq_ignore_ascii_case(last)).copied()
}

/// The units that are so many thousands of another one.
fn scaled(read: &str, thousands: [i8; 2]) -> Vec<String> {
    let all = UNITS.iter().find(|(_, units)| units.contains(&read) && !read.is_empty());
    let Some((at, units)) =
        all.and_then(|(_, units)| Some((units.iter().position(|unit| *unit == read)?, units)))
    else {
        return Vec::new();
    };
    let [first, second] = thousands;
    let of = |steps: i8| {
        let place = usize::try_from(at as i64 + i64::from(steps)).ok();
        place.and_then(|place| units.get(place)).filter(|unit| !unit.is_empty())
    };
    let several = [Some(first), Some(second).filter(|second| *second != 0)];
    several.into_iter().flatten().filter_map(of).map(|unit| (*unit).to_owned()).collect()
}

/// The field of a bridge's file that states a unit, or one of several.
fn fields(quantity: &str, units: &[String]) -> String {
    let fields: Vec<String> =
        units.iter().map(|unit| format!("{quantity} = {{ at = …, unit = \"{unit}\" }}")).collect();
    match fields.is_empty() {
        true => format!("{quantity} = {{ at = …, unit = … }}"),
        false => fields.join(" or "),
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}: {}. Allowed: {}", self.kind, self.found, self.allowed)
    }
}
