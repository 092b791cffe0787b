//! The normalisation statistics of a network, found by their names.

use super::names::tokens;
use super::{Entry, EntryValue, FindError};
use joulebus_predictor::{FEATURES, FeatureSet, LAGS};

/// Features of the command, before the readings.
const COMMANDS: usize = FEATURES - LAGS;

/// Statistics stated in the published model's README: velocities in m/s and rad/s, power in mW.
const PUBLISHED: [(Quantity, f64, f64); 3] = [
    (Quantity::V, 0.0279, 0.0736),
    (Quantity::Omega, 0.0479, 1.0187),
    (Quantity::Power, 3651.7, 374.7),
];

/// The statistics and their sources.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundNormalisation {
    /// Means and standard deviations.
    pub statistics: Statistics,
    /// The source of each, as text.
    pub sources: Vec<String>,
    /// Source of the statistics.
    pub from: StatisticsFrom,
}

/// The source of the statistics.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StatisticsFrom {
    /// The file.
    File,
    /// The file has none, so those of the published model's documentation, if recordings agree with
    /// them.
    Assumed,
    /// Chosen by the caller: those of the published model's documentation.
    Published,
    /// Chosen by the caller: those of the recordings.
    Recordings,
}

/// Means and standard deviations, in the file's units: velocities in m/s and rad/s, power in mW or
/// W.
#[derive(Clone, Debug, PartialEq)]
pub enum Statistics {
    /// One pair each for `v`, `ω` and power, as in the published model.
    Shared {
        /// Mean and standard deviation of `v`.
        v: (f64, f64),
        /// Mean and standard deviation of `ω`.
        omega: (f64, f64),
        /// Mean and standard deviation of the readings and the forecast.
        power: (f64, f64),
    },
    /// One pair per feature, in the file's order.
    Own {
        /// Means: of all features, or of those before the readings.
        mean: Vec<f64>,
        /// Standard deviations, as many.
        std: Vec<f64>,
        /// Mean and standard deviation of the forecast, and of the readings unless they have their
        /// own.
        power: (f64, f64),
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Quantity {
    V,
    Omega,
    Power,
    Features,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Statistic {
    Mean,
    Std,
    Variance,
}

/// True if a name denotes a statistic of any quantity.
pub(super) fn is_statistic(path: &str) -> bool {
    statistic(&tokens(last(path))).is_some()
}

fn last(path: &str) -> &str {
    path.rsplit('.').next().unwrap_or(path)
}

fn statistic(tokens: &[String]) -> Option<Statistic> {
    tokens.iter().find_map(|token| match token.as_str() {
        "mean" | "means" | "mu" | "avg" | "average" | "loc" => Some(Statistic::Mean),
        "std" | "stds" | "stddev" | "sd" | "sigma" | "scale" => Some(Statistic::Std),
        "var" | "variance" => Some(Statistic::Variance),
        _ => None,
    })
}

fn quantity(tokens: &[String]) -> Option<Quantity> {
    tokens.iter().find_map(|token| match token.as_str() {
        "v" | "vel" | "velocity" | "linear" | "lin" => Some(Quantity::V),
        "w" | "omega" | "angular" | "ang" => Some(Quantity::Omega),
        "power" | "p" | "pwr" | "y" | "target" | "targets" | "output" | "out" | "label" => {
            Some(Quantity::Power)
        }
        "x" | "feature" | "features" | "input" | "inputs" | "feat" => Some(Quantity::Features),
        _ => None,
    })
}

struct Named<'a> {
    path: &'a str,
    quantity: Quantity,
    statistic: Statistic,
    values: Vec<f64>,
}

/// Finds the statistics among the entries that are not weights.
pub(super) fn find<'a>(
    entries: impl Iterator<Item = &'a Entry>,
    set: FeatureSet,
) -> Result<FoundNormalisation, FindError> {
    let named: Vec<Named<'_>> = entries.filter_map(|entry| named(entry, set)).collect();
    if named.is_empty() {
        return Ok(published(set));
    }
    for Named { path, statistic, values, .. } in &named {
        let (what, allowed, fine): (_, _, fn(f64) -> bool) = match statistic {
            Statistic::Mean => ("a mean", "finite numbers", f64::is_finite),
            Statistic::Std | Statistic::Variance => {
                let fine = |value: f64| value >= 0.0 && value.is_finite();
                ("a deviation", "finite numbers from 0", fine)
            }
        };
        if let Some(value) = values.iter().copied().find(|value| !fine(*value)) {
            let path = (*path).to_owned();
            return Err(FindError::Statistic { path, value, what, allowed });
        }
    }
    let mut search = Search { named: &named, sources: Vec::new(), missing: Vec::new() };
    let power = search.pair(Quantity::Power, "power");
    let features = (
        search.one(Quantity::Features, Statistic::Mean),
        search.one(Quantity::Features, Statistic::Std),
    );
    let statistics = match (features, set) {
        ((Some(mean), Some(std)), _) if mean.len() == std.len() => {
            Statistics::Own { mean, std, power }
        }
        (_, set) if !set.needs_command() => {
            Statistics::Shared { v: (0.0, 1.0), omega: (0.0, 1.0), power }
        }
        _ => Statistics::Shared {
            v: search.pair(Quantity::V, "v"),
            omega: search.pair(Quantity::Omega, "omega"),
            power,
        },
    };
    let Search { sources, missing, .. } = search;
    if !missing.is_empty() {
        return Err(FindError::Normalisation {
            found: sources.join(", "),
            missing: missing.join(", "),
        });
    }
    Ok(FoundNormalisation { statistics, sources, from: StatisticsFrom::File })
}

/// An entry as a statistic, if its name and size allow it.
fn named(entry: &Entry, set: FeatureSet) -> Option<Named<'_>> {
    let own = tokens(last(&entry.path));
    let all = tokens(&entry.path);
    let statistic = statistic(&own).or_else(|| statistic(&all))?;
    let values = match &entry.value {
        EntryValue::Number(value) => vec![*value],
        EntryValue::Tensor(tensor) => tensor.values().to_vec(),
        _ => return None,
    };
    // The last component of a path takes precedence over the others.
    let quantity = quantity(&own).or_else(|| quantity(&all));
    let quantity = match (values.len(), quantity) {
        (1, Some(Quantity::Features) | None) => return None,
        (1, Some(quantity)) => quantity,
        (FEATURES | COMMANDS, _) if set == FeatureSet::Full => Quantity::Features,
        (LAGS, _) if set == FeatureSet::PowerOnly => Quantity::Features,
        _ => return None,
    };
    Some(Named { path: &entry.path, quantity, statistic, values })
}

struct Search<'a> {
    named: &'a [Named<'a>],
    sources: Vec<String>,
    missing: Vec<String>,
}

impl Search<'_> {
    /// Mean and deviation of a scalar quantity. 0 and 1 for missing ones.
    fn pair(&mut self, quantity: Quantity, name: &str) -> (f64, f64) {
        let mut number = |statistic, what: &str, instead| {
            let found = self.one(quantity, statistic);
            match found.as_deref() {
                Some(&[value]) => value,
                _ => {
                    self.missing.push(format!("{what} of {name}"));
                    instead
                }
            }
        };
        (number(Statistic::Mean, "mean", 0.0), number(Statistic::Std, "deviation", 1.0))
    }

    /// The statistic with the shortest name.
    fn one(&mut self, quantity: Quantity, statistic: Statistic) -> Option<Vec<f64>> {
        let with = |statistic: Statistic| {
            self.named
                .iter()
                .filter(|named| (named.quantity, named.statistic) == (quantity, statistic))
                .min_by_key(|named| tokens(named.path).len())
        };
        let (named, values) = match (with(statistic), statistic) {
            (Some(named), _) => (named, named.values.clone()),
            (None, Statistic::Std) => {
                let named = with(Statistic::Variance)?;
                (named, named.values.iter().map(|value| value.sqrt()).collect())
            }
            (None, _) => return None,
        };
        let shown: Vec<String> = values.iter().map(|value| format!("{value:.6}")).collect();
        let shown = shown.join(", ");
        self.sources.push(format!("{} = {shown}", named.path));
        Some(values)
    }
}

/// The statistics of the published model.
fn published(set: FeatureSet) -> FoundNormalisation {
    let of = |wanted: Quantity| {
        let found = PUBLISHED.iter().find(|(quantity, ..)| *quantity == wanted);
        found.map_or((0.0, 1.0), |&(_, mean, std)| (mean, std))
    };
    let (v, omega, power) = (of(Quantity::V), of(Quantity::Omega), of(Quantity::Power));
    let mut sources = vec![format!("power: mean {} mW, deviation {} mW", power.0, power.1)];
    if set == FeatureSet::Full {
        sources.push(format!("v: mean {} m/s, deviation {} m/s", v.0, v.1));
        let (mean, std) = omega;
        sources.push(format!("omega: mean {mean} rad/s, deviation {std} rad/s"));
    }
    FoundNormalisation {
        statistics: Statistics::Shared { v, omega, power },
        sources,
        from: StatisticsFrom::Assumed,
    }
}
