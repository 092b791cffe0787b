//! Edits of a mapping, tried on what was read before they are told.

use crate::finding::{Finding, Source};
use crate::judge::{Judge, Known, TimeUnit};
use crate::observation::Observation;
use crate::quantity::Quantity;

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
    /// Applies it to an observation. What is unknown stays so.
    fn apply(&self, seen: &mut Observation, rows: &Rows<impl Sized>) {
        match self {
            Self::Turn => {
                seen.current_a = -seen.current_a;
                if rows.turns_power {
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
        if rows.is_product && !seen.power_w.is_nan() {
            seen.power_w = seen.voltage_v * seen.current_a;
        }
    }

    fn known(&self, known: Known) -> Known {
        match self {
            Self::Unit { quantity, .. } => known.stated(*quantity),
            Self::Time { .. } => known.timed(TimeUnit::Named),
            Self::Turn => known.turned(!known.is_turned()),
            Self::Missing { .. } => known,
        }
    }

    /// How a source says it, if it can. `column`: its name for the quantity.
    pub(crate) fn said(&self, source: Source, column: &str) -> Option<String> {
        use Source::{Array, Bag, Bridge, Program, Recording, TurnedBag, TurnedRecording};
        let map = |text: String| match text.contains(char::is_whitespace) {
            true => format!("--map '{text}'"),
            false => format!("--map {text}"),
        };
        let field = |quantity: Quantity, key: &str, value: String| {
            format!("{} = {{ at = …, {key} = {value} }}", quantity.name())
        };
        match (self, source) {
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

/// What was read, on which edits are tried.
#[derive(Debug, Clone, Copy)]
pub struct Rows<R> {
    rows: R,
    known: Known,
    is_product: bool,
    turns_power: bool,
}

/// Edits of other findings that are tried together with one.
const MAX_TOGETHER: usize = 8;

impl<R: Iterator<Item = Observation> + Clone> Rows<R> {
    /// Rows in the order in which they came, and what is known of their source. `is_product`: power
    /// is voltage times current.
    pub fn new(rows: R, known: Known, is_product: bool) -> Self {
        let products = rows.clone().map(|seen| seen.power_w * seen.current_a);
        let turns_power = products.filter(|product| !product.is_nan()).sum::<f64>() >= 0.0;
        Self { rows, known, is_product, turns_power }
    }

    /// The edits of a finding that leave it no more, and bring no other error: by themselves, or
    /// with those of `all` other findings. None if the rows do not show it without them. `column`
    /// is the source's name for a finding's quantity.
    pub fn working(
        &self,
        finding: &Finding,
        all: &[Finding],
        column: impl Fn(&Finding) -> Option<String>,
    ) -> Vec<Edit> {
        let edits = |of: &Finding| of.edits(column(of).as_deref());
        let own = edits(finding);
        if own.is_empty() || !self.judged(&[]).iter().any(|found| found.is_like(finding)) {
            return Vec::new();
        }
        let others = all.iter().filter(|other| !other.is_like(finding));
        let mut together: Vec<Vec<Edit>> = vec![Vec::new()];
        for candidates in others.map(edits).filter(|edits| !edits.is_empty()) {
            let with: Vec<Vec<Edit>> = together
                .iter()
                .flat_map(|before| {
                    let with =
                        |edit: &Edit| [before.as_slice(), std::slice::from_ref(edit)].concat();
                    candidates.iter().map(with).collect::<Vec<_>>()
                })
                .collect();
            together.extend(with);
            together.truncate(MAX_TOGETHER);
        }
        let works = |edit: &Edit| {
            together.iter().any(|others| {
                let left = self.judged(&[std::slice::from_ref(edit), others.as_slice()].concat());
                let is_new =
                    |left: &Finding| left.is_error() && !all.iter().any(|one| one.is_like(left));
                !left.iter().any(|left| left.is_like(finding) || is_new(left))
            })
        };
        own.into_iter().filter(works).collect()
    }

    /// Findings with edits.
    fn judged(&self, edits: &[Edit]) -> Vec<Finding> {
        let known = edits.iter().fold(self.known, |known, edit| edit.known(known));
        let mut judge = Judge::new(known);
        for mut seen in self.rows.clone() {
            edits.iter().for_each(|edit| edit.apply(&mut seen, self));
            judge.take(&seen);
        }
        judge.findings()
    }
}
