//! Distributions of relative errors, as quantiles.

use std::f64::consts::FRAC_1_SQRT_2;

use libm::{erfc, exp, log};

/// Number of stored quantiles of an error.
pub const KNOTS: usize = 9;

/// Probabilities of the stored quantiles, ascending and symmetric.
pub const QUANTILES: [f32; KNOTS] = [0.01, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99];

/// Middle and half width of the 90 % interval.
pub(crate) fn middle_and_half(values: &[f32; KNOTS]) -> (f32, f32) {
    (0.5 * (values[1] + values[7]), 0.5 * (values[7] - values[1]))
}

/// ln(p / (1 − p)): quantiles are interpolated over it, and extrapolated beyond the outer ones.
fn logit(p: f64) -> f64 {
    log(p / (1.0 - p))
}

/// The quantile at probability `p`. `None` unless 0 < p < 1.
pub(crate) fn quantile(values: &[f32; KNOTS], p: f32) -> Option<f32> {
    if !(p > 0.0 && p < 1.0) {
        return None;
    }
    let at = logit(p.into());
    let knots = QUANTILES.map(|knot| logit(knot.into()));
    let last = KNOTS - 2;
    let segment = (0..last).find(|index| at < knots[index + 1]).unwrap_or(last);
    let share = (at - knots[segment]) / (knots[segment + 1] - knots[segment]);
    let (lower, upper) = (f64::from(values[segment]), f64::from(values[segment + 1]));
    Some((lower + share * (upper - lower)) as f32)
}

/// The probability of a value below one that is normally distributed about `value` with the
/// standard deviation `sd`, and independent. NaN for a NaN.
pub(crate) fn probability(values: &[f32; KNOTS], value: f32, sd: f32) -> f32 {
    // Each sum is of a function that is smooth at the distance of its terms.
    if sd > (values[7] - values[1]) / 6.58 {
        /// Share of the distribution that each quantile stands for.
        const SHARES: [f64; KNOTS] = [0.03, 0.045, 0.1, 0.2, 0.25, 0.2, 0.1, 0.045, 0.03];
        let below = |quantile: f32| {
            let deviations = f64::from(quantile - value) / f64::from(sd);
            0.5 * erfc(deviations * FRAC_1_SQRT_2)
        };
        let terms = values.iter().zip(SHARES);
        return terms.map(|(quantile, share)| share * below(*quantile)).sum::<f64>() as f32;
    }
    // The nodes of Gauss and Hermite.
    let knots = QUANTILES.map(|knot| logit(knot.into()));
    let at = |deviations: f64| below(values, &knots, f64::from(value) + deviations * f64::from(sd));
    let (middle, sides) = (at(0.0), at(-3.0f64.sqrt()) + at(3.0f64.sqrt()));
    (middle + (sides - 2.0 * middle) / 6.0) as f32
}

/// The probability of a value below `value`: the inverse of [`quantile`]. `knots` are the logits of
/// [`QUANTILES`].
fn below(values: &[f32; KNOTS], knots: &[f64; KNOTS], value: f64) -> f64 {
    let last = KNOTS - 2;
    let segment = (0..last).find(|index| value < values[index + 1].into()).unwrap_or(last);
    let (lower, upper) = (f64::from(values[segment]), f64::from(values[segment + 1]));
    let width = upper - lower;
    // Without width it is a step.
    let share = if width > 0.0 || value.is_nan() {
        (value - lower) / width
    } else if value < lower {
        f64::NEG_INFINITY
    } else {
        f64::INFINITY
    };
    let at = knots[segment] + share * (knots[segment + 1] - knots[segment]);
    1.0 / (1.0 + exp(-at))
}
