//! Distributions of relative errors, as quantiles.

use libm::{exp, log};

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
    /// Deviations of a normal distribution beyond which nothing counts.
    const REACH: f64 = 5.0;
    /// Longest piece, in deviations: the quadrature of one is exact to five digits.
    const PIECE: f64 = 1.25;
    /// The nodes of Gauss and Legendre, and their weights.
    const NODES: [(f64, f64); 4] = [
        (-0.861_136_311_594_052_6, 0.347_854_845_137_453_9),
        (-0.339_981_043_584_856_3, 0.652_145_154_862_546_1),
        (0.339_981_043_584_856_3, 0.652_145_154_862_546_1),
        (0.861_136_311_594_052_6, 0.347_854_845_137_453_9),
    ];
    let knots = QUANTILES.map(|knot| logit(knot.into()));
    let (value, sd) = (f64::from(value), f64::from(sd));
    if value.is_nan() || sd.is_nan() || values.iter().any(|value| value.is_nan()) {
        return f32::NAN;
    }
    if sd <= 0.0 {
        return below(values, &knots, value) as f32;
    }
    // The function is smooth but for its kinks at the quantiles, so each piece ends at one.
    let (mut from, mut sum, mut mass) = (-REACH, 0.0, 0.0);
    let kinks = values.iter().map(|kink| (f64::from(*kink) - value) / sd);
    for kink in kinks.chain([REACH]) {
        let kink = kink.clamp(from, REACH);
        let pieces = ((kink - from) / PIECE).ceil();
        let half = 0.5 * (kink - from) / pieces.max(1.0);
        for piece in 0..pieces as usize {
            let middle = from + (2 * piece + 1) as f64 * half;
            for (node, weight) in NODES {
                let deviations = middle + half * node;
                let density = half * weight * exp(-0.5 * deviations * deviations);
                sum += density * below(values, &knots, value + deviations * sd);
                mass += density;
            }
        }
        from = kink;
    }
    (sum / mass) as f32
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
