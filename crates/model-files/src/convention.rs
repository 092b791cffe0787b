//! Which features a network was trained on: found out by trying.
//!
//! A file holds weights and statistics, but not how its author wrote the features. What is known
//! of the published model is their list: `v, ω`, their derivatives, their magnitudes, five
//! readings. What is not known has few possible answers, and a wrong one forecasts badly, so every
//! [`Convention`] forecasts the readings of recorded trials and the best one is taken. All of them
//! read the row as documented: the command of row *t* and the readings before it, derivatives over
//! the step before.

mod choose;
mod score;

use std::fmt;
use std::str::FromStr;

use joulebus_predictor::ModelError;

pub use choose::{Choice, Ranked};

/// The unit of the file's power statistics.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PowerUnit {
    /// Milliwatt, as in the published dataset.
    Milliwatt,
    /// Watt.
    Watt,
}

/// The order of the readings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LagOrder {
    /// Newest first.
    Newest,
    /// Oldest first.
    Oldest,
}

/// Where the readings stand among the features.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lags {
    /// After the features of the command.
    Last,
    /// Before them.
    First,
}

/// How the derivatives are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Derivative {
    /// Over the time step, each by its own statistics.
    OwnPerSecond,
    /// The plain difference, each by its own statistics.
    OwnPerStep,
    /// Over the time step, of the normalised velocity.
    NormalisedPerSecond,
    /// The plain difference of the normalised velocity.
    NormalisedPerStep,
    /// Over the time step, not normalised.
    RawPerSecond,
    /// The plain difference, not normalised.
    RawPerStep,
}

/// How the magnitudes are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Magnitude {
    /// Each by its own statistics.
    Own,
    /// By mean and deviation of the velocity.
    AsVelocity,
    /// Divided by the deviation of the velocity.
    Divided,
    /// Not normalised.
    Raw,
    /// The magnitude of the normalised velocity.
    OfNormalised,
}

/// A way to write the features.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Convention {
    /// The unit of power.
    pub unit: PowerUnit,
    /// The order of the readings.
    pub order: LagOrder,
    /// Where the readings stand.
    pub lags: Lags,
    /// The derivatives.
    pub derivative: Derivative,
    /// The magnitudes.
    pub magnitude: Magnitude,
}

const UNITS: [(PowerUnit, &str); 2] = [(PowerUnit::Milliwatt, "mW"), (PowerUnit::Watt, "W")];
const ORDERS: [(LagOrder, &str); 2] = [
    (LagOrder::Newest, "newest-first"),
    (LagOrder::Oldest, "oldest-first"),
];
const PLACES: [(Lags, &str); 2] = [(Lags::Last, "lags-last"), (Lags::First, "lags-first")];
const DERIVATIVES: [(Derivative, &str); 6] = [
    (Derivative::OwnPerSecond, "d-own-per-second"),
    (Derivative::OwnPerStep, "d-own-per-step"),
    (Derivative::NormalisedPerSecond, "d-normalised-per-second"),
    (Derivative::NormalisedPerStep, "d-normalised-per-step"),
    (Derivative::RawPerSecond, "d-raw-per-second"),
    (Derivative::RawPerStep, "d-raw-per-step"),
];
const MAGNITUDES: [(Magnitude, &str); 5] = [
    (Magnitude::Own, "abs-own"),
    (Magnitude::AsVelocity, "abs-as-velocity"),
    (Magnitude::Divided, "abs-divided"),
    (Magnitude::Raw, "abs-raw"),
    (Magnitude::OfNormalised, "abs-of-normalised"),
];

fn name_of<T: PartialEq>(names: &[(T, &'static str)], wanted: &T) -> &'static str {
    let named = names.iter().find(|(value, _)| value == wanted);
    named.map_or("", |(_, name)| name)
}

fn named<T: Copy>(names: &[(T, &'static str)], wanted: &str) -> Option<T> {
    let found = names.iter().find(|(_, name)| *name == wanted);
    found.map(|(value, _)| *value)
}

impl fmt::Display for Convention {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parts = [
            name_of(&UNITS, &self.unit),
            name_of(&ORDERS, &self.order),
            name_of(&PLACES, &self.lags),
            name_of(&DERIVATIVES, &self.derivative),
            name_of(&MAGNITUDES, &self.magnitude),
        ];
        out.write_str(&parts.join("+"))
    }
}

impl FromStr for Convention {
    type Err = String;

    /// Reads what `Display` writes.
    fn from_str(text: &str) -> Result<Convention, String> {
        let parts: Vec<&str> = text.split('+').collect();
        let convention = match parts.as_slice() {
            &[unit, order, lags, derivative, magnitude] => named(&UNITS, unit)
                .zip(named(&ORDERS, order))
                .zip(named(&PLACES, lags))
                .zip(named(&DERIVATIVES, derivative))
                .zip(named(&MAGNITUDES, magnitude)),
            _ => None,
        };
        let Some(((((unit, order), lags), derivative), magnitude)) = convention else {
            let example = "mW+newest-first+lags-last+d-own-per-second+abs-own";
            return Err(format!(
                "{text:?} is no convention; they look like {example}"
            ));
        };
        Ok(Convention {
            unit,
            order,
            lags,
            derivative,
            magnitude,
        })
    }
}

/// Why no convention was taken.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ChooseError {
    /// There is too little to try the conventions on.
    #[error(
        "the recordings have {found} readings with all that a forecast needs (command, five \
         readings before it, no gap); at least {allowed} are needed"
    )]
    TooFewRows {
        /// Rows found.
        found: usize,
        /// Rows needed.
        allowed: usize,
    },
    /// The power does not change.
    #[error("all {rows} readings are the same; recordings with changing power are needed")]
    ConstantPower {
        /// Rows.
        rows: usize,
    },
    /// Even the best convention forecasts worse than a constant.
    #[error(
        "no convention fits: the best one, {best}, has R² {r2:.4} on these {rows} readings, no \
         better than a constant; are they of the robots that the model was trained for? To import \
         it nevertheless, name a convention"
    )]
    NothingFits {
        /// The best convention.
        best: Convention,
        /// Its R².
        r2: f64,
        /// Readings.
        rows: usize,
    },
    /// The convention that was asked for does not belong to these statistics.
    #[error("{asked} does not go with the file's statistics; those that do: {allowed}")]
    NotACandidate {
        /// What was asked for.
        asked: Convention,
        /// What is possible.
        allowed: String,
    },
    /// The features cannot be written as ours.
    #[error(
        "{convention} (R² {r2:.4}) cannot run here: it needs |v − mean|, and the worker's features \
         hold |v|; the best that can run is {runner_up} (R² {runner_up_r2:.4})"
    )]
    CannotRun {
        /// The convention.
        convention: Convention,
        /// Its R².
        r2: f64,
        /// The best that can run.
        runner_up: Convention,
        /// Its R².
        runner_up_r2: f64,
    },
    /// The finished network was refused.
    #[error("with {convention}: {source}")]
    Model {
        /// The convention.
        convention: Convention,
        /// Why.
        source: ModelError,
    },
}

/// Where a network comes from, for its card.
#[derive(Clone, Copy, Debug)]
pub struct Origin<'a> {
    /// Name for people.
    pub name: &'a str,
    /// The file that was imported.
    pub file: &'a str,
    /// Its SHA-256, hexadecimal.
    pub sha256: &'a str,
}
