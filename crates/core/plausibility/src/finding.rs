//! Findings: the found value, the allowed values, and the remedy.

use std::fmt;
use std::str::FromStr;

use serde::Serialize;

use crate::edit::{Edit, Origin, UNNAMED};
use crate::quantity::{Quantity, UNMEASURED_A, number};

/// Kind of a finding. Its name is what `--accept` takes, and its [`Card`](crate::Card) says what it
/// means.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
#[expect(missing_docs, reason = "their cards say it")]
pub enum Kind {
    Sign,
    Unit,
    Clock,
    Hold,
    NeverCame,
    Range,
    Saturation,
    Constant,
    Sentinel,
    Mismatch,
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
}

impl fmt::Display for Kind {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(self.name())
    }
}

impl FromStr for Kind {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::ALL.into_iter().find(|kind| kind.name() == text).ok_or_else(|| {
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

impl Severity {
    /// The name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Error => "error",
            Self::Warning => "warning",
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Remedy {
    Turn,
    State(&'static str),
    /// State another unit: so many thousands of the one in which it was read, or so many. 0: none.
    Scale {
        read: &'static str,
        thousands: [i8; 2],
    },
    /// Give time in the right unit, by its name in `--map` and its size, s.
    Seconds(&'static str, f64),
    /// State which number stands for no reading: as its file has it, and in SI units.
    Missing {
        written: f64,
        value: f64,
    },
    /// Measure the current, which always has this value in SI.
    Unmeasured(f64),
    Clock,
    Expire,
    Name,
    Sensor,
    Limits,
    Split,
    Agree,
    Counter,
    Apart,
    Read,
}

impl Remedy {
    /// What to do in a file, a bag, a bridge's file and a program: as in a file where it is empty.
    /// Of remedies with edits, what to do if no edit is one. Q is the quantity, C its column.
    const fn words(self) -> [&'static str; 4] {
        match self {
            Self::Turn | Self::State(_) | Self::Scale { .. } | Self::Seconds(..) => [
                "correct the values of C: no option mends them",
                "correct the driver: no option mends its Q",
                "correct the source: no key of the bridge's file mends its Q",
                "publish Q in SI units, positive while the battery discharges",
            ],
            // Zero is a speed and a current as well.
            Self::Missing { written: 0.0, .. } => {
                ["leave the fields empty where there is no reading", "", "", ""]
            }
            Self::Missing { .. } | Self::Unmeasured(_) => {
                ["leave Q out where there is no reading", "", "", ""]
            }
            Self::Clock => ["record times that advance with every row", "", "", ""],
            Self::Expire => [
                "record what the robot executes, 0 where it stopped by itself",
                "set command_holds_s in a mapping file",
                "set command_holds_s",
                "",
            ],
            Self::Name => [
                "name its column with --map Q=COLUMN",
                "name its topic in a mapping file",
                "correct its topic or `at` in the bridge's file",
                "publish Q",
            ],
            Self::Limits => {
                let limits = "correct the values, or state another platform's limits";
                let own = "correct the values or the platform's limits";
                [limits, "", own, own]
            }
            Self::Sensor => ["check the sensor and its driver", "", "", ""],
            Self::Split => ["divide the recording where it changes", "", "", ""],
            Self::Agree => {
                let agree =
                    "name power, voltage and current of one circuit, or leave out the others";
                [agree, "", "", ""]
            }
            Self::Counter => {
                ["record the Q itself: an energy (Wh) or a charge (Ah) is not read", "", "", ""]
            }
            Self::Apart => {
                let apart = "give each source a topic of its own, or stop one";
                ["record one source", apart, apart, ""]
            }
            Self::Read => ["leave it out where it is none", "", "", ""],
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
    pub(crate) fn new(
        (kind, severity): (Kind, Severity),
        quantity: impl Into<Option<Quantity>>,
        readings: u64,
        remedy: Remedy,
        found: String,
        allowed: impl Into<String>,
    ) -> Self {
        let (quantity, allowed) = (quantity.into(), allowed.into());
        Self { kind, quantity, severity, readings, found, allowed, remedy }
    }

    /// In a row of a file, another recording begins: there the time goes back by so much, s, or the
    /// header comes again.
    #[must_use]
    pub fn appended(row: usize, back_s: Option<f64>) -> Self {
        let what = match back_s {
            Some(back_s) => format!("the time goes back by {} s", number(back_s)),
            None => "the header comes again".to_owned(),
        };
        let found = format!("{what} in row {row}. The rows from there on are another trial");
        let of = (Kind::Clock, Severity::Warning);
        Self::new(of, None, 1, Remedy::Split, found, "a file has one recording")
    }

    /// A column looks like a command, and is not read: `option` reads it.
    #[must_use]
    pub fn unread(column: &str, option: &str, rows: u64) -> Self {
        let found = format!(
            "column {column} looks like a command and is not read. Forecasts are better with it"
        );
        let allowed = format!("if it is one, it is read with {option}");
        let of = (Kind::NeverCame, Severity::Warning);
        Self::new(of, Quantity::V, rows, Remedy::Read, found, allowed)
    }

    /// True if another one is of the same kind and quantity.
    #[must_use]
    pub fn is_like(&self, other: &Self) -> bool {
        (self.kind, self.quantity) == (other.kind, other.quantity)
    }

    /// The edits of a mapping that may remedy it, of which one is right. `column` is the name that
    /// the source has for the quantity.
    #[must_use]
    pub fn edits(&self, column: Option<&str>) -> Vec<Edit> {
        match (self.remedy, self.quantity) {
            (Remedy::Seconds(unit, unit_s), _) => vec![Edit::Time { unit, unit_s }],
            (Remedy::Turn, _) => vec![Edit::Turn],
            (Remedy::Scale { read, thousands }, Some(quantity)) => {
                let stated = column.and_then(|column| stated(quantity.name(), column));
                let edit = |steps: i8| {
                    let unit = scaled(stated.unwrap_or(read), steps)?.to_owned();
                    Some(Edit::Unit { quantity, unit, factor: 1e3_f64.powi(steps.into()) })
                };
                let [first, second] = thousands;
                let several = [Some(first), Some(second).filter(|second| *second != 0)];
                several.into_iter().flatten().filter_map(edit).collect()
            }
            (Remedy::State(unit), Some(quantity)) => {
                let factor = match unit {
                    "percent" | "cmps" => 1e-2,
                    "share" => 1e2,
                    "mmps" => 1e-3,
                    "degps" => std::f64::consts::PI / 180.0,
                    _ => return Vec::new(),
                };
                vec![Edit::Unit { quantity, unit: unit.to_owned(), factor }]
            }
            (Remedy::Missing { written, value }, Some(quantity)) if written != 0.0 => {
                vec![Edit::Missing { quantity, written, value }]
            }
            _ => Vec::new(),
        }
    }

    /// The remedy, in the words of the source, as if each of its edits worked. `column` is the name
    /// that the source has for the quantity, if known.
    #[must_use]
    pub fn remedy(&self, origin: Origin, column: Option<&str>) -> String {
        self.remedy_by(origin, column, &self.edits(column))
    }

    /// The same with those of its edits that were tried, and leave no finding.
    #[must_use]
    pub fn remedy_by(&self, origin: Origin, column: Option<&str>, edits: &[Edit]) -> String {
        let quantity = self.quantity.map_or("time", Quantity::name);
        let column = column.unwrap_or(UNNAMED);
        let options = edits.iter().filter_map(|edit| edit.said(origin, column));
        let options = options.collect::<Vec<_>>().join(" or ");
        let is_file = matches!(origin, Origin::Recording | Origin::TurnedRecording | Origin::Array);
        let remedy = match self.remedy {
            Remedy::Unmeasured(value) => unmeasured(value, origin, column),
            Remedy::Apart if is_file && column != UNNAMED => {
                format!("tell the sources apart, --map robot={column}, or record one of them")
            }
            _ if !options.is_empty() && origin == Origin::Program => {
                format!("publish {quantity} with {options}")
            }
            Remedy::Turn if !options.is_empty() => format!("turn the sign with {options}"),
            Remedy::Missing { .. } if !options.is_empty() => {
                format!("say that it is no reading with {options}")
            }
            Remedy::Seconds(..) if !options.is_empty() => {
                format!("state the unit of the time, {options}")
            }
            _ if !options.is_empty() => format!("state the unit, {options}, or correct the source"),
            // Its columns have one unit each.
            Remedy::Scale { .. } | Remedy::State(_) | Remedy::Seconds(..)
                if origin == Origin::Array =>
            {
                format!(
                    "convert its {quantity}, because an array has s, m/s, rad/s, mV, mA and mW, or \
                     give a CSV with --map"
                )
            }
            other => {
                let words = other.words();
                let own = match origin {
                    _ if is_file => words[0],
                    Origin::Bag | Origin::TurnedBag => words[1],
                    Origin::Bridge => words[2],
                    _ => words[3],
                };
                let own = if own.is_empty() { words[0] } else { own };
                let named = |word: &str| match word.strip_suffix([',', ':']).unwrap_or(word) {
                    "Q" => word.replace('Q', quantity),
                    "C" => word.replace('C', column),
                    "Q=COLUMN" => format!("{quantity}=COLUMN"),
                    _ => word.to_owned(),
                };
                own.split(' ').map(named).collect::<Vec<_>>().join(" ")
            }
        };
        let kind = self.kind;
        match (self.remedy, origin) {
            // Accepting it would turn an unknown into a number.
            (Remedy::Unmeasured(_), _) | (_, Origin::Program) => remedy,
            (_, Origin::Bridge) => {
                format!("{remedy}. If it is right, set accept = [\"{kind}\"]")
            }
            _ => format!("{remedy}. If it is right, add --accept {kind}"),
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
fn unmeasured(value: f64, origin: Origin, column: &str) -> String {
    let sign = if origin == Origin::TurnedRecording { -1.0 } else { 1.0 };
    let units: &[f64] = match (origin, stated("current", column)) {
        (Origin::Array, _) | (_, Some("mA")) => &[1e-3],
        (_, Some("A")) => &[1.0],
        (_, Some(_)) => &[1e-6],
        (_, None) => &[1.0, 1e-3],
    };
    let is_reserved =
        units.iter().any(|unit| (sign * value / unit - UNMEASURED_A).abs() < RESERVED_WITHIN);
    let say = match origin {
        Origin::Recording | Origin::TurnedRecording | Origin::Array if is_reserved => {
            "say that it is no reading with --map missing:=-1"
        }
        Origin::Bridge => "leave the current out of the mapping",
        Origin::Program => "publish no current, and no power made of it",
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

/// The unit that is so many thousands of another one.
fn scaled(read: &str, thousands: i8) -> Option<&'static str> {
    let (_, units) = UNITS.iter().find(|(_, units)| units.contains(&read) && !read.is_empty())?;
    let at = units.iter().position(|unit| *unit == read)? as i64 + i64::from(thousands);
    units.get(usize::try_from(at).ok()?).copied().filter(|unit| !unit.is_empty())
}

impl fmt::Display for Finding {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}: {}. Allowed: {}", self.kind, self.found, self.allowed)
    }
}
