//! Compares the statistics by which a network normalises with those of the recordings.

use joulebus_predictor::{FEATURES, FeatureSet, LAGS, Normalisation};

use super::ChooseError;
use crate::Statistics;

/// A convention is ruled out if another one's deviations are nearer to the recordings' deviations
/// by this factor, averaged over the features in which the two differ. At 30 Hz the factor is 30
/// between per step and per second, and 1000 between milliwatt and watt.
const RULED_OUT: f64 = 3.0;
/// Maximum distance between the recordings' mean power and the published one, in deviations.
const MAX_DEVIATIONS: f64 = 3.0;
/// Maximum ratio of the velocities' deviations.
const MAX_FACTOR: f64 = 4.0;

/// Mean and deviation of a quantity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Spread {
    pub(super) mean: f64,
    pub(super) std: f64,
}

impl Spread {
    pub(super) fn new(values: impl Iterator<Item = f64> + Clone) -> Spread {
        let count = values.clone().count().max(1) as f64;
        let mean = values.clone().sum::<f64>() / count;
        let variance = values.map(|value| (value - mean).powi(2)).sum::<f64>() / count;
        let std = variance.sqrt();
        // The deviation of a constant is rounding error.
        let std = if std > mean.abs() * 1e-7 { std } else { 0.0 };
        Spread { mean, std }
    }

    /// Distance between the stated statistics and these, as a logarithm. 0 if one of the two is of
    /// a constant.
    fn distance(self, mean: f64, std: f64) -> f64 {
        if !(self.std > 0.0 && std > 0.0) {
            return 0.0;
        }
        let shift = (mean - self.mean).abs() / std.max(self.std);
        (std / self.std).ln().abs() + shift.ln_1p()
    }
}

/// Distance of each stated statistic from the recordings': of the features, then of the forecast.
pub(super) fn distances(
    statistics: &Statistics,
    set: FeatureSet,
    normalisation: &Normalisation,
    recorded: &[Spread],
    target: Spread,
) -> Vec<f64> {
    let mut distances = vec![0.0; FEATURES];
    for feature in set.range().filter(|feature| *feature < FEATURES) {
        let is_stated = match statistics {
            Statistics::Own { .. } => true,
            // Derivatives and magnitudes are scaled by those of the velocities.
            Statistics::Shared { .. } => !(2..FEATURES - LAGS).contains(&feature),
        };
        if is_stated {
            distances[feature] = recorded[feature].distance(
                f64::from(normalisation.feature_mean[feature]),
                f64::from(normalisation.feature_std[feature]),
            );
        }
    }
    let (mean_w, std_w) = (normalisation.power_mean_w, normalisation.power_std_w);
    distances.push(target.distance(f64::from(mean_w), f64::from(std_w)));
    distances
}

/// True if `other` is so much nearer to the recordings that `own` is ruled out.
pub(super) fn is_ruled_out(own: &[f64], other: &[f64]) -> bool {
    let differences: Vec<f64> = own
        .iter()
        .zip(other)
        .map(|(own, other)| own - other)
        .filter(|difference| difference.abs() > 1e-6)
        .collect();
    let sum: f64 = differences.iter().sum();
    !differences.is_empty() && sum / differences.len() as f64 >= RULED_OUT.ln()
}

/// Refuses recordings that cannot be of the published model's robot.
pub(super) fn check_published(
    statistics: &Statistics,
    set: FeatureSet,
    recorded: &[Spread],
    target: Spread,
) -> Result<(), ChooseError> {
    let Statistics::Shared { v, omega, power } = statistics else {
        return Ok(());
    };
    // The published constants are in mW.
    let (mean_w, std_w) = (power.0 / 1e3, power.1 / 1e3);
    let mut fits = (target.mean - mean_w).abs() <= MAX_DEVIATIONS * std_w;
    let mut found = format!("power {:.3} ± {:.3} W", target.mean, target.std);
    let mut published = format!("power {mean_w:.3} ± {std_w:.3} W");
    if set.needs_command() {
        for (at, name, unit, stated) in [(0, "v", "m/s", v.1), (1, "omega", "rad/s", omega.1)] {
            let std = recorded[at].std;
            fits &= std <= MAX_FACTOR * stated;
            found.push_str(&format!(", deviation of {name} {std:.4} {unit}"));
            published.push_str(&format!(", {stated} {unit}"));
        }
    }
    match fits {
        true => Ok(()),
        false => Err(ChooseError::NotPublished { found, published }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_deviation_nearer_to_the_recordings_rules_the_other_out() {
        // The checkpoint's deviation of dv is .50. The recordings have .417 per second.
        let dv = Spread { mean: 0.0, std: 0.417 };
        let (per_second, per_step) = (dv.distance(0.0, 0.5), dv.distance(0.0, 0.5 * 30.0));
        assert!(is_ruled_out(&[per_step], &[per_second]));
        assert!(!is_ruled_out(&[per_second], &[per_step]));
        assert!(!is_ruled_out(&[per_second], &[per_second]));
        let two_hz = dv.distance(0.0, 0.5 * 2.0);
        assert!(!is_ruled_out(&[two_hz], &[per_second]));
    }
}
