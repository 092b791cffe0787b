//! Errors of a platform's energy model, learned from all its robots together.
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
//! The errors of outlooks, which do not know the commands, are counted apart. Their trained
//! distribution is that of plans, stretched by [`WIDER`]. The same shadow forecasts show how far an
//! outlook should lean on the last reading and on the robot's own mean: exponentiated gradients of
//! the absolute error (Kivinen and Warmuth, Information and Computation 132, 1997).
//!
//! Counts are integers, so the result does not depend on the order in which robots are processed.

use serde::{Deserialize, Serialize};

use crate::levels::{SHADOWS, SHADOWS_S};
use crate::memory::{self, GROUPS, LEVEL, Memory, POWER, Shown, shown};
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
/// Width of the errors of outlooks before the first, in that of plans, which know the commands.
const WIDER: f32 = 1.2;
/// Maximum number of errors that are remembered. Older ones fade.
const MEMORY: f32 = 200.0;

/// Kinds of errors that are counted: of plans at each of [`SHADOWS_S`], then of outlooks.
pub const ERRORS: usize = 2 * SHADOWS;
/// Forecasts that an outlook is a mean of: the last reading, the level, the robot's own mean.
pub const PARTS: usize = 3;
/// Shares of [`PARTS`] in an outlook before the first error.
const SHARES: [[f32; PARTS]; SHADOWS] = [[0.2, 0.65, 0.15], [0.05, 0.65, 0.3], [0.02, 0.48, 0.5]];
/// Share of the robot's own mean in a plan without commands, beside the level.
pub(crate) fn own_share(shares: [f32; SHADOWS]) -> f32 {
    let of = |shadow: usize| SHARES[shadow][2] / (SHARES[shadow][1] + SHARES[shadow][2]);
    shares[0] * of(0) + shares[1] * of(1) + shares[2] * of(2)
}

/// A pull of the platform's mean power, as an integer.
pub(crate) const PULL: f32 = 65536.0;

/// Sums over errors, which do not depend on the order in which they are added.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(bound(deserialize = "T: Deserialize<'de> + Default"))]
pub struct ErrorCounts<T = i64> {
    /// Numbers of errors in each class.
    pub classes: [[T; CLASSES]; ERRORS],
    /// Growth of the error of outlooks with a larger share of the last reading and of the robot's
    /// own mean. Also the larger square of the two, in 1/65536.
    pub pulls: [[T; PARTS]; SHADOWS],
    /// What the robots of each [group](crate::group_of) have shown. Older files have none, or less.
    #[serde(default, deserialize_with = "memory::read_groups")]
    pub groups: [Shown<T>; GROUPS],
}

impl<T> ErrorCounts<T> {
    /// All numbers.
    pub fn numbers(&self) -> impl Iterator<Item = &T> {
        let groups = self.groups.as_flattened().as_flattened();
        self.classes.as_flattened().iter().chain(self.pulls.as_flattened()).chain(groups)
    }

    /// The same of other numbers.
    pub fn map<U>(&self, to: impl Fn(&T) -> U) -> ErrorCounts<U> {
        ErrorCounts {
            classes: self.classes.each_ref().map(|counts| counts.each_ref().map(&to)),
            pulls: self.pulls.each_ref().map(|pulls| pulls.each_ref().map(&to)),
            groups: self
                .groups
                .each_ref()
                .map(|shown| shown.each_ref().map(|quantity| quantity.each_ref().map(&to))),
        }
    }
}

impl ErrorCounts<f32> {
    /// Forgets the levels of the groups: those of another day say little of this one's floor.
    #[must_use]
    pub fn without_levels(mut self) -> Self {
        self.groups.iter_mut().for_each(|shown| shown[LEVEL] = [0.0; 2]);
        self
    }

    /// True if robots could have shown what the groups remember.
    pub fn has_sound_groups(&self) -> bool {
        self.groups.iter().all(memory::is_sound)
    }
}

/// The errors of a robot's shadow forecasts that have ended.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NewErrors {
    /// The class of each error.
    pub classes: [Option<u8>; ERRORS],
    /// The pulls of [`ErrorCounts`].
    pub pulls: [[i64; PARTS]; SHADOWS],
    /// What the robot has shown with them.
    pub shown: Shown,
}

impl NewErrors {
    /// What the robot has shown, with its level in the power of its commands, if it is known: once a
    /// second.
    pub fn shown_with(&self, level: Option<f32>) -> Shown {
        let mut all = self.shown;
        if let Some(level) = level.filter(|_| all[POWER][0] > 0) {
            all[LEVEL] = shown(LEVEL, 1.0, level);
        }
        all
    }

    /// Converts it to counts: those of a robot.
    pub fn counted(&self, robot: u32) -> ErrorCounts {
        let one = |class: &Option<u8>| {
            std::array::from_fn(|place| i64::from(*class == Some(place as u8)))
        };
        let mut groups = [Shown::default(); GROUPS];
        groups[memory::group_of(robot)] = self.shown;
        ErrorCounts { classes: self.classes.each_ref().map(one), pulls: self.pulls, groups }
    }
}

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
    /// The bounds of the trained interval.
    pub const TRAINED: Self = Self { lower: [-1.0; SHADOWS], upper: [1.0; SHADOWS] };

    /// Middle and half width at one horizon.
    #[inline(always)]
    pub(crate) fn middle_and_half(&self, shadow: usize) -> (f32, f32) {
        let (lower, upper) = (self.lower[shadow], self.upper[shadow]);
        (0.5 * (lower + upper), 0.5 * (upper - lower))
    }

    /// True if every bound is finite, and lower bounds are below upper ones. They are not where
    /// plan states of an older version have none.
    pub fn is_sound(&self) -> bool {
        let mut pairs = self.lower.iter().zip(&self.upper);
        pairs.all(|(lower, upper)| lower.is_finite() && upper.is_finite() && lower < upper)
    }
}

/// Errors of a platform's robots, as new forecasts use them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlatformErrors {
    /// Bounds of the intervals of plans.
    pub plans: ErrorBounds,
    /// Bounds of the intervals of outlooks.
    pub outlooks: ErrorBounds,
    /// Shares of [`PARTS`] in an outlook at each of [`SHADOWS_S`], 1 in all.
    pub shares: [[f32; PARTS]; SHADOWS],
    /// What the robots have shown of themselves.
    pub memory: Memory,
}

impl PlatformErrors {
    /// Before the first error.
    pub const TRAINED: Self = Self {
        plans: ErrorBounds::TRAINED,
        outlooks: ErrorBounds { lower: [-WIDER; SHADOWS], upper: [WIDER; SHADOWS] },
        shares: SHARES,
        memory: Memory::TRAINED,
    };
}

/// The errors of a platform's robots so far, and what follows from them.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// The trained distribution.
    prior: [[f32; CLASSES]; ERRORS],
    seen: ErrorCounts<f32>,
    platform: PlatformErrors,
}

impl Calibration {
    /// Before the first error.
    pub fn new(model: &EnergyModel) -> Self {
        let prior = std::array::from_fn(|error| {
            let errors = model.errors_at(SHADOWS_S[error % SHADOWS]);
            let (middle, half) = quantiles::middle_and_half(&errors);
            let half = if error < SHADOWS { half } else { half / WIDER };
            let below = |edge: f32| quantiles::probability(&errors, middle + half * edge, 0.0);
            std::array::from_fn(|class| {
                let [from, to] = range(class);
                let from = if class == 0 { 0.0 } else { below(from) };
                let to = if class == CLASSES - 1 { 1.0 } else { below(to) };
                PRIOR * (to - from).max(0.0)
            })
        });
        Self { prior, seen: ErrorCounts::default(), platform: PlatformErrors::TRAINED }
    }

    /// The errors that new forecasts use.
    #[inline(always)]
    pub const fn platform(&self) -> &PlatformErrors {
        &self.platform
    }

    /// The remembered errors, from which [`Calibration::restore`] continues.
    pub const fn seen(&self) -> &ErrorCounts<f32> {
        &self.seen
    }

    /// Continues from remembered errors, which are finite, and whose counts are not negative.
    pub fn restore(&mut self, seen: &ErrorCounts<f32>) {
        self.seen = *seen;
        for error in 0..ERRORS {
            self.update(error);
        }
        self.platform.memory = Memory::of(&self.seen.groups);
    }

    /// Adds errors, and what the robots have shown with them.
    pub fn add(&mut self, counts: &ErrorCounts) {
        if counts.groups.as_flattened().as_flattened().iter().any(|number| *number != 0) {
            for (seen, shown) in self.seen.groups.iter_mut().zip(&counts.groups) {
                memory::add(seen, shown);
            }
            self.platform.memory = Memory::of(&self.seen.groups);
        }
        for (error, counted) in counts.classes.iter().enumerate() {
            if counted.iter().all(|count| *count == 0) {
                continue;
            }
            let seen = &mut self.seen.classes[error];
            for (seen, count) in seen.iter_mut().zip(counted) {
                *seen += *count as f32;
            }
            let total: f32 = seen.iter().sum();
            if total > MEMORY {
                seen.iter_mut().for_each(|seen| *seen *= MEMORY / total);
            }
            if let Some(shadow) = error.checked_sub(SHADOWS) {
                let number: i64 = counted.iter().sum();
                let keeps = MEMORY / (MEMORY + number as f32);
                for (seen, pull) in self.seen.pulls[shadow].iter_mut().zip(counts.pulls[shadow]) {
                    *seen = keeps * (*seen + pull as f32 / PULL);
                }
            }
            self.update(error);
        }
    }

    fn update(&mut self, error: usize) {
        let (seen, prior) = (&self.seen.classes[error], &self.prior[error]);
        let known = seen.iter().any(|seen| *seen > 0.0);
        let weights = std::array::from_fn(|class| seen[class] + prior[class]);
        let shadow = error % SHADOWS;
        let (bounds, trained) = if error < SHADOWS {
            (&mut self.platform.plans, 1.0)
        } else {
            self.platform.shares[shadow] = shares(SHARES[shadow], &self.seen.pulls[shadow]);
            (&mut self.platform.outlooks, WIDER)
        };
        bounds.lower[shadow] = if known { quantile(&weights, 0.05) } else { -trained };
        bounds.upper[shadow] = if known { quantile(&weights, 0.95) } else { trained };
    }
}

/// The shares that pulls lead to. The step is smaller, the larger the pulls were.
fn shares(start: [f32; PARTS], [last, own, square]: &[f32; PARTS]) -> [f32; PARTS] {
    /// Squares that weigh as much as those of the pulls.
    const START: f32 = 0.1;
    let rate = 1.0 / (START + square).sqrt();
    let factor = |pull: f32| libm::expf((-rate * pull).clamp(-20.0, 20.0));
    let raw = [start[0] * factor(*last), start[1], start[2] * factor(*own)];
    let sum: f32 = raw.iter().sum();
    raw.map(|share| share / sum)
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
    use super::{
        CLASSES, Calibration, ErrorBounds, ErrorCounts, NewErrors, PULL, PlatformErrors, SHADOWS,
        class_of, range,
    };
    use crate::model::EnergyModel;

    fn calibration() -> Calibration {
        let mut model = EnergyModel::untrained(10.0);
        model.errors = [[-0.4, -0.2, -0.15, -0.05, 0.0, 0.05, 0.15, 0.2, 0.4]; 6];
        Calibration::new(&model)
    }

    fn after(errors: &[f32]) -> ErrorBounds {
        let mut calibration = calibration();
        for error in errors {
            let mut errors = NewErrors::default();
            errors.classes[0] = Some(class_of(*error));
            calibration.add(&errors.counted(0));
        }
        calibration.platform().plans
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
        restored.restore(&ErrorCounts::default());
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
        let mut counts = ErrorCounts::default();
        counts.classes[1] = std::array::from_fn(|class| class as i64 * 1_000_000);
        counts.classes[4] = counts.classes[1];
        counts.pulls[1] = [PULL as i64 * 50_000_000, -(PULL as i64), i64::from(u32::MAX)];
        let (mut one, mut other) = (calibration(), calibration());
        one.add(&counts);
        other.restore(one.seen());
        assert_eq!(one, other);
        let PlatformErrors { plans, outlooks, shares, .. } = one.platform();
        assert!(plans.is_sound() && outlooks.is_sound());
        assert!(shares.iter().all(|shares| (shares.iter().sum::<f32>() - 1.0).abs() < 1e-6));
    }

    #[test]
    fn an_outlook_leans_on_what_had_the_smaller_error() {
        let mut calibration = calibration();
        let mut errors = NewErrors::default();
        errors.classes[SHADOWS] = Some(class_of(0.5));
        // With more of the last reading it would have been 4 % of the mean power nearer.
        let pull = 0.04 * PULL;
        errors.pulls[0] = [-pull as i64, pull as i64, (0.04 * pull) as i64];
        for _ in 0..100 {
            calibration.add(&errors.counted(0));
        }
        let [last, level, own] = calibration.platform().shares[0];
        assert!(last > 0.7 && level > own && own < 0.02, "{last} {level} {own}");
        assert_eq!(calibration.platform().shares[1..], PlatformErrors::TRAINED.shares[1..]);
        assert_eq!(calibration.platform().plans, ErrorBounds::TRAINED);
    }
}
