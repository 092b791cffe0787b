//! The time between readings, with the power and the speed in it.

use joulebus_dataset::inspect::{Limits, Range};
use joulebus_dataset::trial::{Column as Recorded, Trial};
use joulebus_eval::score::Recording;
use joulebus_settings::Platform;
use joulebus_statistics::metrics::{quantile, sorted};

use crate::document::Cell;
use crate::material::label;

/// Runs above which the 5 % at each end are no longer in a range.
pub(super) const MANY_RUNS: usize = 20;
/// A pause between two readings of more than this many median ones is unknown, not metered.
pub(super) const LONGEST_STEP: f64 = 5.0;
/// Fewer steps are too few for a mean.
pub(super) const MIN_STEPS: usize = 10;
/// Less distance is too little for an energy per metre, m.
pub(super) const MIN_DISTANCE_M: f64 = 1.0;
/// From this angular velocity on, a robot turns on the spot, rad/s.
pub(super) const TURNS_RADPS: f64 = 0.05;
/// Below this share of the greatest speed, a robot stands.
pub(super) const RESTS: f64 = 0.02;
/// The time between two readings of which the power is known.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step {
    pub(super) duration_s: f64,
    /// Mean of both readings.
    pub(super) power_w: f64,
    pub(super) speed_mps: f64,
    pub(super) turning_radps: f64,
}

/// Rows that give no power, by reason.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct LeftOut {
    pub(super) missing: usize,
    pub(super) implausible: usize,
    pub(super) on_charger: usize,
    /// Rows whose time does not advance.
    pub(super) clock: usize,
    /// Implausible speeds: the power of these rows counts.
    pub(super) speeds: usize,
    /// Time between readings that are too far apart, s.
    pub(super) pauses_s: f64,
}

#[derive(Debug, Clone)]
pub(super) struct Run {
    pub(super) name: String,
    pub(super) robot: String,
    pub(super) rows: usize,
    pub(super) readings: usize,
    pub(super) steps: Vec<Step>,
    pub(super) left_out: LeftOut,
    pub(super) is_measured: bool,
}

/// Sums of steps. Energy and time of steps of unknown speed are in the first two alone.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Sums {
    pub(super) time_s: f64,
    pub(super) energy_j: f64,
    pub(super) driven_s: f64,
    pub(super) driven_j: f64,
    pub(super) distance_m: f64,
}

impl Sums {
    pub(super) fn of<'a>(steps: impl IntoIterator<Item = &'a Step>) -> Self {
        let mut sums = Self::default();
        for step in steps {
            let energy_j = step.power_w * step.duration_s;
            sums.time_s += step.duration_s;
            sums.energy_j += energy_j;
            if step.speed_mps.is_finite() {
                sums.driven_s += step.duration_s;
                sums.driven_j += energy_j;
                sums.distance_m += step.speed_mps * step.duration_s;
            }
        }
        sums
    }

    pub(super) fn mean_w(&self) -> f64 {
        if self.time_s > 0.0 { self.energy_j / self.time_s } else { f64::NAN }
    }

    /// Wh per metre. NaN if the speed is unknown or the robot hardly moved.
    pub(super) fn wh_per_m(&self) -> f64 {
        let is_enough = self.distance_m >= MIN_DISTANCE_M;
        if is_enough { self.driven_j / 3600.0 / self.distance_m } else { f64::NAN }
    }
}

/// What counts as plausible: the limits of the platform, else those of any wheeled robot.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plausible {
    pub(super) power_w: Range,
    pub(super) speed_mps: Range,
    pub(super) turning_radps: Range,
}

impl Plausible {
    pub(super) fn new(platform: Option<&Platform>) -> Self {
        let Limits { power_w, v_mps, omega_radps, .. } = Limits::default();
        let Some(platform) = platform else {
            return Self { power_w, speed_mps: v_mps, turning_radps: omega_radps };
        };
        Self {
            power_w: Range {
                least: platform.power_min_w.into(),
                greatest: platform.power_max_w.into(),
            },
            speed_mps: Range::within(platform.v_max_mps.into()),
            turning_radps: Range::within(platform.omega_max_radps.into()),
        }
    }
}

pub(super) fn holds(range: Range, value: f64) -> bool {
    range.least <= value && value <= range.greatest
}

impl Run {
    pub(super) fn new(recording: &Recording, trial: &Trial, plausible: Plausible) -> Self {
        let (mut left_out, mut latest_ns) = (LeftOut::default(), i64::MIN);
        let mut readings: Vec<(usize, f64)> = Vec::new();
        let power_w = trial.column(Recorded::Power).unwrap_or_default();
        for (row, power_w) in power_w.iter().enumerate() {
            let at_ns = trial.offset_ns()[row];
            if at_ns <= latest_ns {
                left_out.clock += 1;
            } else if holds(plausible.power_w, *power_w) {
                readings.push((row, *power_w));
            } else if !power_w.is_nan() {
                left_out.implausible += 1;
            } else if trial.is_on_charger(row) {
                left_out.on_charger += 1;
            } else {
                left_out.missing += 1;
            }
            latest_ns = latest_ns.max(at_ns);
        }
        let measured = trial.column(Recorded::VMeasured);
        let (speed, turning) = match measured {
            Some(_) => (measured, trial.column(Recorded::OmegaMeasured)),
            None => (trial.column(Recorded::V), trial.column(Recorded::Omega)),
        };
        let is_wrong = |value: &&f64| !value.is_nan() && !holds(plausible.speed_mps, **value);
        left_out.speeds = speed.unwrap_or_default().iter().filter(is_wrong).count();
        let time_s = |row: usize| trial.offset_ns()[row] as f64 * 1e-9;
        let pairs = || readings.windows(2).map(|pair| (pair[0], pair[1]));
        let durations = sorted(pairs().map(|(a, b)| time_s(b.0) - time_s(a.0)));
        let longest_s = LONGEST_STEP * quantile(&durations, 0.5);
        let mut steps = Vec::with_capacity(durations.len());
        for ((before, before_w), (row, power_w)) in pairs() {
            let duration_s = time_s(row) - time_s(before);
            let charges = (before + 1..row).any(|between| trial.is_on_charger(between));
            let is_step = duration_s <= longest_s && !charges;
            if !is_step {
                left_out.pauses_s += if charges { 0.0 } else { duration_s };
                continue;
            }
            steps.push(Step {
                duration_s,
                power_w: f64::midpoint(before_w, power_w),
                speed_mps: mean_size(speed, before + 1..=row, plausible.speed_mps),
                turning_radps: mean_size(turning, before + 1..=row, plausible.turning_radps),
            });
        }
        Self {
            name: label(&recording.name),
            robot: recording.robot.clone(),
            rows: trial.rows(),
            readings: readings.len(),
            steps,
            left_out,
            is_measured: measured.is_some(),
        }
    }

    pub(super) fn sums(&self) -> Sums {
        Sums::of(&self.steps)
    }
}

/// Mean absolute value of the plausible values of some rows. NaN without one.
pub(super) fn mean_size(
    values: Option<&[f64]>,
    rows: std::ops::RangeInclusive<usize>,
    plausible: Range,
) -> f64 {
    let known = values.and_then(|values| values.get(rows)).unwrap_or_default().iter();
    let known = known.filter(|value| holds(plausible, **value));
    let (sum, count) = known.fold((0.0, 0), |(sum, count), value| (sum + value.abs(), count + 1));
    if count > 0 { sum / f64::from(count) } else { f64::NAN }
}

/// What a robot does in a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Motion {
    Rests,
    Turns,
    /// Drives, at a speed of this part of the range.
    Drives(usize),
    Unknown,
}

/// Equal parts of the speeds that occur.
#[derive(Debug, Clone, Copy)]
pub(super) struct Speeds {
    pub(super) rests_mps: f64,
    pub(super) part_mps: f64,
    pub(super) parts: usize,
}

impl Speeds {
    /// Six to twelve parts with round ends.
    pub(super) fn new(runs: &[Run]) -> Self {
        let steps = runs.iter().flat_map(|run| &run.steps);
        // A few wrong speeds must not widen the parts.
        let ascending = sorted(steps.map(|step| step.speed_mps));
        let greatest = quantile(&ascending, 0.999).max(0.0);
        let power = libm::pow(10.0, libm::floor(libm::log10(greatest / 6.0)));
        let rounds = [5.0, 2.0, 1.0].map(|multiple| multiple * power);
        let round = rounds.into_iter().find(|part| *part * 6.0 <= greatest * (1.0 + 1e-9));
        let part_mps = round.filter(|part| *part > 0.0 && part.is_finite()).unwrap_or(1.0);
        let parts = libm::ceil(greatest / part_mps - 1e-9).clamp(0.0, 20.0) as usize;
        Self { rests_mps: RESTS * greatest, part_mps, parts }
    }

    pub(super) fn motion(&self, step: &Step) -> Motion {
        let (speed_mps, turning_radps) = (step.speed_mps, step.turning_radps);
        if speed_mps.is_nan() {
            Motion::Unknown
        } else if speed_mps > self.rests_mps {
            let part = (speed_mps / self.part_mps) as usize;
            Motion::Drives(part.min(self.parts.saturating_sub(1)))
        } else if turning_radps >= TURNS_RADPS {
            Motion::Turns
        } else {
            Motion::Rests
        }
    }

    /// Every motion, and its words.
    pub(super) fn motions(&self) -> Vec<(Motion, String)> {
        let mut motions = vec![
            (Motion::Rests, "at rest".to_owned()),
            (Motion::Turns, "turning on the spot".to_owned()),
        ];
        let decimals = decimals(self.part_mps, 1);
        motions.extend((0..self.parts).map(|part| {
            let [from, to] = [part, part + 1].map(|end| end as f64 * self.part_mps);
            let words = match part + 1 == self.parts {
                true => format!("{from:.decimals$} m/s and above"),
                false => format!("{from:.decimals$} to {to:.decimals$} m/s"),
            };
            (Motion::Drives(part), words)
        }));
        motions.push((Motion::Unknown, "speed not known".to_owned()));
        motions
    }
}

/// The power in one motion.
#[derive(Debug, Clone)]
pub(super) struct AtSpeed {
    pub(super) motion: Motion,
    pub(super) words: String,
    pub(super) sums: Sums,
    pub(super) steps: usize,
    pub(super) power_w: Vec<f64>,
}

impl AtSpeed {
    /// Of every motion that occurs in steps.
    pub(super) fn of<'a>(
        speeds: &Speeds,
        steps: &(impl Iterator<Item = &'a Step> + Clone),
    ) -> Vec<Self> {
        let found = speeds.motions().into_iter().map(|(motion, words)| {
            let own = steps.clone().filter(|step| speeds.motion(step) == motion);
            Self {
                motion,
                words,
                sums: Sums::of(own.clone()),
                steps: own.clone().count(),
                power_w: sorted(own.map(|step| step.power_w)),
            }
        });
        found.filter(|one| one.steps > 0).collect()
    }

    pub(super) fn mean_w(&self) -> f64 {
        if self.steps < MIN_STEPS { f64::NAN } else { self.sums.mean_w() }
    }

    pub(super) fn range_w(&self) -> [f64; 2] {
        let is_enough = self.steps >= MIN_STEPS;
        [0.1, 0.9].map(|share| if is_enough { quantile(&self.power_w, share) } else { f64::NAN })
    }
}

/// Least and greatest value, or of many values the ends of the middle 90 %. NaN of fewer than two.
pub(super) fn range(values: &[f64]) -> [f64; 2] {
    let known = sorted(values.iter().copied());
    let cut = match known.len() {
        ..2 => return [f64::NAN; 2],
        2..MANY_RUNS => 0.0,
        _ => 0.05,
    };
    [quantile(&known, cut), quantile(&known, 1.0 - cut)]
}

/// Decimals for so many digits.
pub(super) fn decimals(value: f64, digits: i32) -> usize {
    if !(value.abs() > 0.0 && value.is_finite()) {
        return 0;
    }
    (digits - 1 - libm::floor(libm::log10(value.abs()) + 1e-9) as i32).clamp(0, 9) as usize
}

/// A number with three digits.
pub(super) fn significant(value: f64) -> Cell {
    Cell::Number(value, decimals(value, 3))
}

pub(super) fn ends([low, high]: [f64; 2]) -> Cell {
    Cell::Range([low, high], decimals(high, 3))
}

pub(super) fn spanned(values: [f64; 2]) -> String {
    ends(values).shown()
}
