//! What was found, what is allowed, and what to do.

use std::fmt;
use std::str::FromStr;

use serde::Serialize;

use crate::quantity::Quantity;

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
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 8] = [
        Self::Sign,
        Self::Unit,
        Self::Clock,
        Self::Hold,
        Self::NeverCame,
        Self::Range,
        Self::Saturation,
        Self::Constant,
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

/// Whether a finding stops a verb.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Severity {
    /// Results would be wrong: a verb stops.
    Error,
    /// Results may be wrong: it is shown.
    Warning,
}

/// Where readings come from: each has its own remedies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// A table, an archive or a capture, read by a verb of joulebus.
    Recording,
    /// A recording whose current is turned already.
    TurnedRecording,
    /// A bag, read by `joulebus import`.
    Bag,
    /// A bridge's file.
    Bridge,
    /// A program that publishes by itself.
    Program,
}

/// What to do about a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Remedy {
    /// Turn the sign of power and current.
    Turn,
    /// State the unit.
    State(&'static str),
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
}

/// A finding about one robot.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// The kind.
    pub kind: Kind,
    /// The quantity; `None` for the clock.
    pub quantity: Option<Quantity>,
    /// Whether it stops.
    pub severity: Severity,
    /// Number of readings that show it.
    pub readings: u64,
    /// What was found.
    pub found: String,
    /// What is allowed.
    pub allowed: String,
    #[serde(skip)]
    pub(crate) remedy: Remedy,
}

impl Finding {
    /// What to do, in the words of the source; `column` is the name that the source has for the
    /// quantity, if known.
    #[must_use]
    pub fn remedy(&self, source: Source, column: Option<&str>) -> String {
        let quantity = self.quantity.map_or("time", Quantity::name);
        let column = column.unwrap_or("COLUMN");
        let accept = self.kind;
        let remedy = match (self.remedy, source) {
            (Remedy::Turn, Source::Recording) => {
                "turn the sign with --current discharge-negative".to_owned()
            }
            (Remedy::Turn, Source::TurnedRecording) => {
                "turn the sign with --current discharge-positive".to_owned()
            }
            (Remedy::Turn, Source::Bag) => {
                "state the other sign with --current discharge-positive or discharge-negative"
                    .to_owned()
            }
            (Remedy::Turn, Source::Bridge) => format!(
                "turn the sign: negate = true in the field `{quantity}`, or current = \"discharge-positive\" of the battery"
            ),
            (Remedy::Turn, Source::Program) => format!("publish {quantity} with the other sign"),
            (Remedy::State(unit), Source::Recording | Source::TurnedRecording) => {
                format!("state the unit, --map {quantity}_{unit}={column}, or correct the file")
            }
            (Remedy::State(_), Source::Bag) => {
                format!("state the unit in a mapping file, such as {quantity}_unit = 0.001")
            }
            (Remedy::State(unit), Source::Bridge) => {
                // The units of a bridge's file.
                let unit = match unit {
                    "percent" => "%",
                    "mmps" => "mm/s",
                    "degps" => "deg/s",
                    other => other,
                };
                format!("state the unit in the field: {quantity} = {{ at = …, unit = \"{unit}\" }}")
            }
            (Remedy::State(unit), Source::Program) => {
                format!("{quantity} is expected in SI units, not in {unit}")
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
            (Remedy::Name, Source::Recording | Source::TurnedRecording) => {
                format!("name its column with --map {quantity}=COLUMN")
            }
            (Remedy::Name, Source::Bag) => "name its topic in a mapping file".to_owned(),
            (Remedy::Name, Source::Bridge) => {
                "correct its topic or `at` in the bridge's file".to_owned()
            }
            (Remedy::Name, Source::Program) => format!("publish {quantity}"),
            (Remedy::Limits, Source::Recording | Source::TurnedRecording | Source::Bag) => {
                "correct the values, or state another platform's limits".to_owned()
            }
            (Remedy::Limits, _) => "correct the values or the platform's limits".to_owned(),
            (Remedy::Sensor, _) => "check the sensor and its driver".to_owned(),
        };
        match source {
            Source::Recording | Source::TurnedRecording | Source::Bag => {
                format!("{remedy}. If it is right, --accept {accept}")
            }
            Source::Bridge => format!("{remedy}. If it is right, accept = [\"{accept}\"]"),
            Source::Program => remedy,
        }
    }

    /// Whether it stops a verb.
    #[must_use]
    pub fn is_error(&self) -> bool {
        self.severity == Severity::Error
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}: {}, {}", self.kind, self.found, self.allowed)
    }
}
