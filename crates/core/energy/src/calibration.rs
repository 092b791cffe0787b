//! What the robots of a platform show of the model's errors together.
//!
//! Coverage under a shift is the knowledge of all robots, not of one. A robot on a new floor sees
//! few independent errors before its run ends. The next robot there needs what the first has seen.
//!
//! **Method.** Every ended shadow forecast of every robot gives an error, in units of the trained
//! 90 % interval: −1 is its lower bound and 1 its upper one. The errors are counted in classes. The
//! counts and the trained distribution, which weighs as much as [`PRIOR`] errors, make a
//! distribution whose 5 % and 95 % quantiles are the new bounds. A few errors far outside widen the
//! interval at once, on the side where they are. It takes many errors inside to narrow it.
//!
//! Counts are integers, so the result does not depend on the order in which robots are processed.

use serde::{Deserialize, Serialize};

use crate::levels::{SHADOWS, SHADOWS_S};
use crate::model::EnergyModel;
use crate::quantiles;

/// Number of classes of an error: as many below the middle of the interval as above.
pub const CLASSES: usize = 32;
/// Classes above the middle.
const SIDE: usize = CLASSES / 2;
/// Bounds of the classes above the middle, in half widths of the trained interval: thirds of an
/// octave, with 1 among them.
const EDGES: [f32; SIDE + 1] = [
    0.0,
    0.25,
    0.314_980_27,
    0.396_850_26,
    0.5,
    0.629_960_54,
    0.793_700_5,
    1.0,
    1.259_921,
    1.587_401,
    2.0,
    2.519_842,
    3.174_802,
    4.0,
    5.039_684,
    6.349_604,
    8.0,
];
/// Errors that weigh as much as the trained distribution.
const PRIOR: f32 = 20.0;
/// Maximum number of errors that are remembered; older ones fade.
const MEMORY: f32 = 200.0;

/// Numbers of errors in each class, for each of [`SHADOWS_S`].
pub type ErrorCounts<T = u32> = [[T; CLASSES]; SHADOWS];

/// The class of an error, in half widths from the middle of the trained interval.
pub(crate) fn class_of(error: f32) -> u8 {
    let size = error.abs();
    let side = EDGES[1..SIDE].iter().filter(|edge| size >= **edge).count();
    (if error < 0.0 { SIDE - 1 - side } else { SIDE + side }) as u8
}

/// Lower and upper bound of a class.
fn range(class: usize) -> [f32; 2] {
    match class.checked_sub(SIDE) {
        Some(side) => [EDGES[side], EDGES[side + 1]],
        None => [-EDGES[SIDE - class], -EDGES[SIDE - 1 - class]],
    }
}

/// Bounds of the 90 % interval at each of [`SHADOWS_S`], in half widths from the middle of the
/// trained interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[repr(C)]
pub struct ErrorBounds {
    /// Lower bounds.
    pub lower: [f32; SHADOWS],
    /// Upper bounds.
    pub upper: [f32; SHADOWS],
}

impl ErrorBounds {
    /// Those of the trained interval.
    pub const TRAINED: Self = Self { lower: [-1.0; SHADOWS], upper: [1.0; SHADOWS] };

    /// Middle and half width at one horizon.
    #[inline(always)]
    pub(crate) fn middle_and_half(&self, shadow: usize) -> (f32, f32) {
        let (lower, upper) = (self.lower[shadow], self.upper[shadow]);
        (0.5 * (lower + upper), 0.5 * (upper - lower))
    }

    /// The interval widened by a robot's own factors.
    #[inline(always)]
    #[must_use]
    pub fn scaled(&self, factors: &[f32; SHADOWS]) -> Self {
        let mut scaled = *self;
        for (shadow, factor) in factors.iter().enumerate() {
            let (middle, half) = self.middle_and_half(shadow);
            scaled.lower[shadow] = middle - factor * half;
            scaled.upper[shadow] = middle + factor * half;
        }
        scaled
    }

    /// Whether every bound is finite, and lower bounds are below upper ones. They are not where
    /// plan states of an older version have none.
    pub fn is_sound(&self) -> bool {
        let mut pairs = self.lower.iter().zip(&self.upper);
        pairs.all(|(lower, upper)| lower.is_finite() && upper.is_finite() && lower < upper)
    }
}

/// The errors of a platform's robots so far, and the bounds that follow from them.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// The trained distribution.
    prior: ErrorCounts<f32>,
    seen: ErrorCounts<f32>,
    bounds: ErrorBounds,
}

impl Calibration {
    /// Before the first error.
    pub fn new(model: &EnergyModel) -> Self {
        let prior = std::array::from_fn(|shadow| {
            let errors = model.errors_at(SHADOWS_S[shadow]);
            let (middle, half) = quantiles::middle_and_half(&errors);
            let below = |edge: f32| quantiles::probability(&errors, middle + half * edge, 0.0);
            std::array::from_fn(|class| {
                let [from, to] = range(class);
                let from = if class == 0 { 0.0 } else { below(from) };
                let to = if class == CLASSES - 1 { 1.0 } else { below(to) };
                PRIOR * (to - from).max(0.0)
            })
        });
        let seen = [[0.0; CLASSES]; SHADOWS];
        Self { prior, seen, bounds: ErrorBounds::TRAINED }
    }

    /// The bounds of a new robot's intervals.
    #[inline(always)]
    pub const fn bounds(&self) -> &ErrorBounds {
        &self.bounds
    }

    /// The remembered errors, from which [`Calibration::restore`] continues.
    pub const fn seen(&self) -> &ErrorCounts<f32> {
        &self.seen
    }

    /// Continues from remembered errors, which are finite and not negative.
    pub fn restore(&mut self, seen: &ErrorCounts<f32>) {
        self.seen = *seen;
        for shadow in 0..SHADOWS {
            self.update(shadow);
        }
    }

    /// Adds errors by their classes.
    pub fn add(&mut self, counts: &ErrorCounts) {
        for (shadow, counts) in counts.iter().enumerate() {
            if counts.iter().all(|count| *count == 0) {
                continue;
            }
            let seen = &mut self.seen[shadow];
            for (seen, count) in seen.iter_mut().zip(counts) {
                *seen += *count as f32;
            }
            let total: f32 = seen.iter().sum();
            if total > MEMORY {
                seen.iter_mut().for_each(|seen| *seen *= MEMORY / total);
            }
            self.update(shadow);
        }
    }

    fn update(&mut self, shadow: usize) {
        let (seen, prior) = (&self.seen[shadow], &self.prior[shadow]);
        let known = seen.iter().any(|seen| *seen > 0.0);
        let weights = std::array::from_fn(|class| seen[class] + prior[class]);
        self.bounds.lower[shadow] = if known { quantile(&weights, 0.05) } else { -1.0 };
        self.bounds.upper[shadow] = if known { quantile(&weights, 0.95) } else { 1.0 };
    }
}

/// A quantile of errors that are spread evenly within their classes.
fn quantile(weights: &[f32; CLASSES], p: f32) -> f32 {
    let wanted = p * weights.iter().sum::<f32>();
    let mut below = 0.0;
    for (class, weight) in weights.iter().enumerate() {
        if below + weight >= wanted && *weight > 0.0 {
            let [from, to] = range(class);
            return from + (to - from) * ((wanted - below) / weight).clamp(0.0, 1.0);
        }
        below += weight;
    }
    EDGES[SIDE]
}

#[cfg(test)]
mod tests {
    use super::{CLASSES, Calibration, ErrorBounds, SHADOWS, class_of, range};
    use crate::model::EnergyModel;

    fn calibration() -> Calibration {
        let mut model = EnergyModel::untrained(10.0);
        model.errors = [[-0.4, -0.2, -0.15, -0.05, 0.0, 0.05, 0.15, 0.2, 0.4]; 6];
        Calibration::new(&model)
    }

    fn after(errors: &[f32]) -> ErrorBounds {
        let mut calibration = calibration();
        for error in errors {
            let mut counts = [[0; CLASSES]; SHADOWS];
            counts[0][usize::from(class_of(*error))] = 1;
            calibration.add(&counts);
        }
        *calibration.bounds()
    }

    #[test]
    fn every_error_is_within_its_class() {
        for step in -900..900 {
            let error = step as f32 * 0.01;
            let [from, to] = range(usize::from(class_of(error)));
            let clamped = error.clamp(-7.999, 7.999);
            assert!(from <= clamped && clamped <= to, "{error} in {from} to {to}");
        }
        for class in 1..CLASSES {
            assert_eq!(range(class - 1)[1].abs(), range(class)[0].abs());
        }
    }

    #[test]
    fn without_an_error_the_bounds_are_those_of_training() {
        assert_eq!(after(&[]), ErrorBounds::TRAINED);
        let mut restored = calibration();
        restored.restore(&[[0.0; CLASSES]; SHADOWS]);
        assert_eq!(restored, calibration());
    }

    #[test]
    fn two_errors_far_outside_widen_the_side_where_they_are() {
        let bounds = after(&[3.0, 3.0]);
        assert!(bounds.upper[0] > 2.5, "{bounds:?}");
        assert!((-1.2..=-0.9).contains(&bounds.lower[0]), "{bounds:?}");
        assert_eq!((bounds.lower[1], bounds.upper[1]), (-1.0, 1.0));
    }

    #[test]
    fn many_errors_inside_narrow_the_interval_and_a_change_widens_it_again() {
        let mut errors: Vec<f32> = (0..400).map(|n| (n % 21) as f32 * 0.02 - 0.2).collect();
        let narrow = after(&errors);
        assert!(narrow.upper[0] - narrow.lower[0] < 0.9, "{narrow:?}");
        errors.extend([2.2; 16]);
        let wide = after(&errors);
        assert!(wide.upper[0] > 2.0 && wide.lower[0] < -0.2, "{wide:?}");
    }

    #[test]
    fn millions_of_errors_at_once_are_counted_and_restored() {
        let mut counts = [[0; CLASSES]; SHADOWS];
        counts[1] = std::array::from_fn(|class| class as u32 * 1_000_000);
        let (mut one, mut other) = (calibration(), calibration());
        one.add(&counts);
        other.restore(one.seen());
        assert_eq!(one, other);
        assert!(one.bounds().is_sound());
    }
}
