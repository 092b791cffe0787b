//! The feature convention of a network, identified on recordings.
//!
//! A file holds weights and statistics, but not how the features were computed. The published
//! model's features are known: `v, ω`, their derivatives, their magnitudes, five readings. The
//! unknown details have few possible values. Those under which the file's statistics are far from
//! the recordings' are ruled out first. Each other [`Convention`] is evaluated on the recordings,
//! and the best one is chosen if it is clearly better than the others. All of them read the row as
//! documented: the command of row *t* and the readings before it, derivatives over the step before.

mod choose;
mod score;
mod statistics;

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

/// Position of the readings among the features.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lags {
    /// After the features of the command.
    Last,
    /// Before them.
    First,
}

/// Computation and normalisation of the derivatives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Derivative {
    /// Per second, with statistics of their own.
    OwnPerSecond,
    /// Per step, with statistics of their own.
    OwnPerStep,
    /// Per second, of the normalised velocity.
    NormalisedPerSecond,
    /// Per step, of the normalised velocity.
    NormalisedPerStep,
    /// Per second, not normalised.
    RawPerSecond,
    /// Per step, not normalised.
    RawPerStep,
}

/// Computation and normalisation of the magnitudes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Magnitude {
    /// Normalised with their own statistics.
    Own,
    /// Normalised with mean and deviation of the velocity.
    AsVelocity,
    /// Divided by the deviation of the velocity.
    Divided,
    /// Not normalised.
    Raw,
    /// The magnitude of the normalised velocity.
    OfNormalised,
}

/// A feature convention.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Convention {
    /// The unit of power.
    pub unit: PowerUnit,
    /// The order of the readings.
    pub order: LagOrder,
    /// The position of the readings.
    pub lags: Lags,
    /// The derivatives.
    pub derivative: Derivative,
    /// The magnitudes.
    pub magnitude: Magnitude,
}

const UNITS: [(PowerUnit, &str); 2] = [(PowerUnit::Milliwatt, "mW"), (PowerUnit::Watt, "W")];
const ORDERS: [(LagOrder, &str); 2] =
    [(LagOrder::Newest, "newest-first"), (LagOrder::Oldest, "oldest-first")];
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

    /// Parses the output of `Display`.
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
            return Err(format!("{text:?} is not a convention, an example is {example}"));
        };
        Ok(Convention { unit, order, lags, derivative, magnitude })
    }
}

/// Errors of choosing a convention.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ChooseError {
    /// There are too few readings.
    #[error(
        "the recordings have {found} readings with all inputs of a forecast (command, five \
         readings before it, no gap), at least {allowed} are needed"
    )]
    TooFewRows {
        /// Rows found.
        found: usize,
        /// Rows needed.
        allowed: usize,
    },
    /// The power is constant.
    #[error("all {rows} readings are the same. Recordings with changing power are needed")]
    ConstantPower {
        /// Rows.
        rows: usize,
    },
    /// Even the best convention forecasts worse than a constant.
    #[error(
        "no convention fits: the best one, {best}, has R² {r2:.4} on these {rows} readings, no \
         better than a constant. Check that they are of the robots that the model was trained \
         for. To import \
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
    /// Several conventions forecast equally well.
    #[error(
        "the recordings do not tell these conventions apart: {candidates}. Give recordings with \
            more \
         changing commands, or name one with --convention"
    )]
    Indistinguishable {
        /// The conventions with their R², best first.
        candidates: String,
    },
    /// The file has no statistics, and the published model's statistics do not fit this robot.
    #[error(
        "the file has no normalisation constants, and the recordings are not of the published \
         model's robot: {found}, published: {published}. Add the constants to the file, or take \
         those \
         of the recordings with --normalisation recordings if the network was trained on them"
    )]
    NotPublished {
        /// The statistics of the recordings.
        found: String,
        /// The statistics in the published model's documentation.
        published: String,
    },
    /// The requested convention does not match the statistics.
    #[error("{asked} does not match the file's statistics. Those that match: {allowed}")]
    NotACandidate {
        /// The requested convention.
        asked: Convention,
        /// The matching conventions.
        allowed: String,
    },
    /// The features cannot be expressed by the worker's features.
    #[error(
        "{convention} (R² {r2:.4}) cannot run here: it needs |v − mean|, and the worker's features \
         hold |v|. The best that can run is {runner_up} (R² {runner_up_r2:.4})"
    )]
    CannotRun {
        /// The convention.
        convention: Convention,
        /// Its R².
        r2: f64,
        /// The best executable convention.
        runner_up: Convention,
        /// Its R².
        runner_up_r2: f64,
    },
    /// The predictor refused the network.
    #[error("with {convention}: {source}")]
    Model {
        /// The convention.
        convention: Convention,
        /// The reason.
        source: ModelError,
    },
}

/// Origin of a network, for its card.
#[derive(Clone, Copy, Debug)]
pub struct Origin<'a> {
    /// Display name.
    pub name: &'a str,
    /// The imported file.
    pub file: &'a str,
    /// Its SHA-256, hexadecimal.
    pub sha256: &'a str,
}
