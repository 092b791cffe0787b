//! Drives as parts of recordings, and what few of them can tell.

use joulebus_dataset::rows::RowOrigin;
use joulebus_predictor::LAGS;

/// Relative deviation of the mean power between drives before the first, and the number of drives
/// that it weighs as much as.
pub(crate) const PRIOR_DRIVES: (f64, f64) = (0.3, 2.0);

/// Consecutive rows of one recording.
pub(crate) struct Run {
    pub(crate) origin: RowOrigin,
    /// v, ω and their derivatives.
    pub(crate) motion: Vec<[f32; 4]>,
    /// The reading that ended each step, W.
    pub(crate) power_w: Vec<f64>,
    /// The readings before the first step, oldest first, W.
    pub(crate) before_w: [f64; LAGS],
}

/// The quantile of Student's distribution at probability `p`, with `freedom` degrees of freedom, at
/// least 1. With t = √n tan θ its density is that of cosⁿ⁻¹ θ.
pub(crate) fn student(p: f64, freedom: f64) -> f64 {
    const STEPS: usize = 20_000;
    let step = std::f64::consts::FRAC_PI_2 / STEPS as f64;
    let middle = |at: usize| (at as f64 + 0.5) * step;
    let density = |at: usize| libm::pow(libm::cos(middle(at)), freedom - 1.0);
    let half: f64 = (0..STEPS).map(density).sum();
    let wanted = (p - 0.5).abs() * 2.0 * half;
    let mut below = 0.0;
    let at = (0..STEPS).find(|at| {
        below += density(*at);
        below >= wanted
    });
    let tangent = libm::tan(middle(at.unwrap_or(STEPS - 1)));
    (libm::sqrt(freedom) * tangent).copysign(p - 0.5)
}
