//! The feature convention of a network: how its features were computed, as its author states.

use std::fmt;

use joulebus_predictor::Activation;

/// The unit of the file's power statistics.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PowerUnit {
    /// Watt.
    Watt,
    /// Milliwatt, as in the published dataset.
    Milliwatt,
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
    /// The magnitude of the normalised velocity. The worker cannot compute it.
    OfNormalised,
}

/// The convention of the features of the command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CommandConvention {
    /// The position of the readings.
    pub lags: Lags,
    /// The derivatives.
    pub derivative: Derivative,
    /// The magnitudes.
    pub magnitude: Magnitude,
}

/// A feature convention. `Display` writes it as arguments of `joulebus.models.convert`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Convention {
    /// The unit of power.
    pub unit: PowerUnit,
    /// The order of the readings.
    pub order: LagOrder,
    /// The activation of the hidden layers.
    pub activation: Activation,
    /// The features of the command. `None` if the network reads the powers alone.
    pub command: Option<CommandConvention>,
}

/// The values of a statement, with their names.
pub(super) type Names<T, const N: usize> = [(T, &'static str); N];

pub(super) const UNITS: Names<PowerUnit, 2> =
    [(PowerUnit::Watt, "W"), (PowerUnit::Milliwatt, "mW")];
pub(super) const ORDERS: Names<LagOrder, 2> =
    [(LagOrder::Newest, "newest-first"), (LagOrder::Oldest, "oldest-first")];
pub(super) const LAG_PLACES: Names<Lags, 2> = [(Lags::Last, "last"), (Lags::First, "first")];
pub(super) const DERIVATIVES: Names<Derivative, 6> = [
    (Derivative::OwnPerSecond, "own-per-second"),
    (Derivative::OwnPerStep, "own-per-step"),
    (Derivative::NormalisedPerSecond, "normalised-per-second"),
    (Derivative::NormalisedPerStep, "normalised-per-step"),
    (Derivative::RawPerSecond, "raw-per-second"),
    (Derivative::RawPerStep, "raw-per-step"),
];
pub(super) const MAGNITUDES: Names<Magnitude, 5> = [
    (Magnitude::Own, "own"),
    (Magnitude::AsVelocity, "as-velocity"),
    (Magnitude::Divided, "divided"),
    (Magnitude::Raw, "raw"),
    (Magnitude::OfNormalised, "of-normalised"),
];
pub(super) const ACTIVATIONS: Names<Activation, 3> = [
    (Activation::GeluErf, Activation::GeluErf.name()),
    (Activation::GeluTanh, Activation::GeluTanh.name()),
    (Activation::Relu, Activation::Relu.name()),
];

fn name_of<T: PartialEq>(names: &[(T, &'static str)], wanted: &T) -> &'static str {
    let named = names.iter().find(|(value, _)| value == wanted);
    named.map_or("", |(_, name)| name)
}

impl fmt::Display for Convention {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (unit, order) = (name_of(&UNITS, &self.unit), name_of(&ORDERS, &self.order));
        let activation = self.activation.name();
        write!(out, "unit={unit:?}, lag_order={order:?}, activation={activation:?}")?;
        if let Some(CommandConvention { lags, derivative, magnitude }) = &self.command {
            let derivative = name_of(&DERIVATIVES, derivative);
            let magnitude = name_of(&MAGNITUDES, magnitude);
            write!(out, ", derivative={derivative:?}, magnitude={magnitude:?}")?;
            write!(out, ", lags={:?}", name_of(&LAG_PLACES, lags))?;
        }
        Ok(())
    }
}
