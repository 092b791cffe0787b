//! Edits of a mapping, in the words of each source.

use crate::quantity::Quantity;

/// Origin of readings: each has its own remedies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// A table, an archive or a capture, read by a verb of joulebus.
    Recording,
    /// A recording whose current is turned already.
    TurnedRecording,
    /// An array, whose columns and units are fixed.
    Array,
    /// A bag, read by `joulebus import`.
    Bag,
    /// A bag whose current is turned already.
    TurnedBag,
    /// A bridge's file.
    Bridge,
    /// A program that publishes by itself.
    Program,
}

/// An edit of a mapping, which may remedy a finding.
#[derive(Debug, Clone, PartialEq)]
pub enum Edit {
    /// Turn the sign of the current, and of a power that has its sign.
    Turn,
    /// Read a quantity in another unit, in which its values are so many times as large.
    Unit {
        /// The quantity.
        quantity: Quantity,
        /// The unit, as `--map` names it.
        unit: String,
        /// The factor.
        factor: f64,
    },
    /// Read the time in another unit, of so many seconds.
    Time {
        /// The unit, as `--map` names it.
        unit: &'static str,
        /// Its size, s.
        unit_s: f64,
    },
    /// A number stands for no reading.
    Missing {
        /// The quantity that has it.
        quantity: Quantity,
        /// The number as the file has it.
        written: f64,
        /// In SI units, with the sign of joulebus.
        value: f64,
    },
}

/// The name of a quantity for which the source has none.
pub(crate) const UNNAMED: &str = "COLUMN";

/// The unit of `--map` as a bridge's file has it, if it does.
fn of_bridge(unit: &str) -> Option<&str> {
    match unit {
        "W" | "mW" | "kW" | "V" | "mV" | "A" | "mA" | "share" => Some(unit),
        "percent" => Some("%"),
        "cmps" => Some("cm/s"),
        "mmps" => Some("mm/s"),
        "degps" => Some("deg/s"),
        _ => None,
    }
}

impl Edit {
    /// How a source says it, if it can. `column`: its name for the quantity.
    pub(crate) fn said(&self, origin: Origin, column: &str) -> Option<String> {
        use Origin::{Array, Bag, Bridge, Program, Recording, TurnedBag, TurnedRecording};
        let map = |text: String| match text.contains(char::is_whitespace) {
            true => format!("--map '{text}'"),
            false => format!("--map {text}"),
        };
        let field = |quantity: Quantity, key: &str, value: String| {
            format!("{} = {{ at = …, {key} = {value} }}", quantity.name())
        };
        match (self, origin) {
            (Self::Turn, Recording | Array | Bag) => {
                Some("--current discharge-negative".to_owned())
            }
            (Self::Turn, TurnedRecording | TurnedBag) => {
                Some("--current discharge-positive".to_owned())
            }
            // Fields of documents have names, messages of ROS 2 and VDA 5050 have none.
            (Self::Turn, Bridge) if column == UNNAMED => Some("the other `current`".to_owned()),
            (Self::Turn, Bridge) => {
                Some("negate = true in the fields `power` and `current`".to_owned())
            }
            (Self::Unit { quantity: Quantity::Soc, unit, .. }, Bridge) if column == UNNAMED => {
                Some(format!("percentage_unit = \"{}\" of ROS 2", of_bridge(unit)?))
            }
            (_, Bridge) if column == UNNAMED => None,
            (Self::Missing { written, .. }, Recording | TurnedRecording | Array) => {
                Some(format!("--map missing:={written}"))
            }
            (Self::Missing { quantity, written, .. }, Bridge) => {
                Some(field(*quantity, "unknown", format!("[{written}]")))
            }
            (Self::Unit { quantity, unit, .. }, Recording | TurnedRecording) => {
                Some(map(format!("{}_{unit}={column}", quantity.name())))
            }
            (Self::Time { unit, .. }, Recording | TurnedRecording) => {
                Some(map(format!("time_{unit}={column}")))
            }
            (Self::Unit { quantity, factor, .. }, Bag | TurnedBag) => match quantity {
                Quantity::Voltage => Some(format!("voltage_unit_v = {factor} in a mapping file")),
                Quantity::Current => Some(format!("current_unit_a = {factor} in a mapping file")),
                _ => None,
            },
            (Self::Unit { quantity, unit, .. }, Bridge) => {
                Some(field(*quantity, "unit", format!("\"{}\"", of_bridge(unit)?)))
            }
            (Self::Turn, Program) => Some("the other sign".to_owned()),
            (Self::Unit { unit, .. }, Program) => Some(format!("SI units, not {unit}")),
            (Self::Missing { .. } | Self::Time { .. }, _) | (Self::Unit { .. }, Array) => None,
        }
    }
}
