//! Distributions of relative errors, as quantiles.

use libm::{exp, log};

/// Number of stored quantiles of an error.
pub const KNOTS: usize = 9;

/// Probabilities of the stored quantiles, ascending and symmetric.
pub const QUANTILES: [f32; KNOTS] = [0.01, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99];

/// ln(p / (1 − p)): quantiles are interpolated over it, and extrapolated beyond the outer ones.
fn logit(p: f64) -> f64 {
    log(p / (1.0 - p))
}

/// The quantile at probability `p`; `None` unless 0 < p < 1.
pub(crate) fn quantile(values: &[f32; KNOTS], p: f32) -> Option<f32> {
    if !(p > 0.0 && p < 1.0) {
        return None;
    }
    let at = logit(p.into());
    let knots = QUANTILES.map(|knot| logit(knot.into()));
    let last = KNOTS - 2;
    let segment = (0..last)
        .find(|index| at < knots[index + 1])
        .unwrap_or(last);
    let share = (at - knots[segment]) / (knots[segment + 1] - knots[segment]);
    let (lower, upper) = (f64::from(values[segment]), f64::from(values[segment + 1]));
    Some((lower + share * (upper - lower)) as f32)
}

/// The probability of a value below `value`: the inverse of [`quantile`]. NaN for a NaN.
pub(crate) fn probability(values: &[f32; KNOTS], value: f32) -> f32 {
    if value.is_nan() {
        return f32::NAN;
    }
    let knots = QUANTILES.map(|knot| logit(knot.into()));
    let last = KNOTS - 2;
    let segment = (0..last)
        .find(|index| value < values[index + 1])
        .unwrap_or(last);
    let (lower, upper) = (f64::from(values[segment]), f64::from(values[segment + 1]));
    let width = upper - lower;
    // Without width it is a step.
    let share = if width > 0.0 {
        (f64::from(value) - lower) / width
    } else if f64::from(value) < lower {
        f64::NEG_INFINITY
    } else {
        f64::INFINITY
    };
    let at = knots[segment] + share * (knots[segment + 1] - knots[segment]);
    (1.0 / (1.0 + exp(-at))) as f32
}
