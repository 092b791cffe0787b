//! The alarms of recordings at every step of a grid of limits.

use joulebus_settings::{AlarmLimits, SettingsError, bounds};
use joulebus_statistics::poisson::upper_rate;
use joulebus_wire::Sample;
use rayon::prelude::*;

use super::play::{KINDS, Robot};

/// Their keys.
pub(super) const KEYS: [&str; KINDS] = ["noise_limit", "mismatch_limit", "level_limit"];
/// Steps of the grid: about an eighth more each.
pub(super) const STEPS: usize = 40;

/// A limit at a step: from the least that is allowed to the greatest, in equal ratios, rounded to
/// three significant digits.
pub(super) fn limit(kind: usize, step: usize) -> f64 {
    let allowed = [bounds::NOISE_LIMIT, bounds::MISMATCH_LIMIT, bounds::LEVEL_LIMIT];
    let (least, greatest) = allowed[kind].clone().into_inner();
    let share = step as f64 / (STEPS - 1) as f64;
    let exact = least * libm::pow(greatest / least, share);
    let digits = libm::pow(10.0, 2.0 - libm::floor(libm::log10(exact)));
    ((exact * digits).round() / digits).clamp(least, greatest)
}

pub(super) fn limits([noise, mismatch, level]: [f64; KINDS]) -> AlarmLimits {
    AlarmLimits {
        noise_limit: noise as f32,
        mismatch_limit: mismatch as f32,
        level_limit: level as f32,
    }
}

pub(super) fn values(limits: AlarmLimits) -> [f64; KINDS] {
    [limits.noise_limit, limits.mismatch_limit, limits.level_limit].map(f64::from)
}

/// A recording at the steps of the grid.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Curve {
    pub hours: f64,
    /// Alarms of each kind, up to the first step without any.
    pub raised: Vec<[u64; KINDS]>,
}

impl Curve {
    /// Plays a recording at the steps of the grid from the lowest on, up to the first step without
    /// an alarm. The chosen limits are later played separately.
    fn new(robot: &Robot, samples: &[Sample]) -> Result<Self, SettingsError> {
        let (mut raised, mut hours) = (Vec::new(), 0.0);
        for step in 0..STEPS {
            let at = limits(std::array::from_fn(|kind| limit(kind, step)));
            let played = robot.limited(at).play(samples, None)?;
            hours = played.watched_s / 3600.0;
            if played.raised == [0; KINDS] {
                break;
            }
            raised.push(played.raised);
        }
        Ok(Self { hours, raised })
    }

    pub(super) fn at(&self, kind: usize, step: usize) -> u64 {
        self.raised.get(step).map_or(0, |raised| raised[kind])
    }

    /// The highest step at which the limit is reached.
    pub(super) fn peak(&self, kind: usize) -> Option<usize> {
        self.raised.iter().rposition(|raised| raised[kind] > 0)
    }
}

/// The curves of several recordings.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Curves(pub Vec<Curve>);

impl Curves {
    pub(super) fn new(robot: &Robot, recordings: &[Vec<Sample>]) -> Result<Self, SettingsError> {
        let curves = recordings.par_iter().map(|samples| Curve::new(robot, samples));
        Ok(Self(curves.collect::<Result<_, _>>()?))
    }

    pub(super) fn hours(&self) -> f64 {
        self.0.iter().map(|curve| curve.hours).sum()
    }

    /// Alarms of a kind, a robot and hour.
    pub(super) fn rate(&self, kind: usize, step: usize) -> f64 {
        let alarms: u64 = self.0.iter().map(|curve| curve.at(kind, step)).sum();
        alarms as f64 / self.hours()
    }

    /// Upper bound of the alarms of some kinds together, each at a step, a robot and hour.
    pub(super) fn at_most(&self, steps: &[(usize, usize)], confidence: f64) -> f64 {
        let alarms = |curve: &Curve| steps.iter().map(|(kind, step)| curve.at(*kind, *step)).sum();
        let counts: Vec<u64> = self.0.iter().map(alarms).collect();
        let hours: Vec<f64> = self.0.iter().map(|curve| curve.hours).collect();
        upper_rate(&counts, &hours, confidence)
    }
}
