//! Limits of the residual alarms for a rate of false alarms, with the evidence of recordings.
//!
//! Recordings count as healthy. One half of them decides the ratios of the limits. The other
//! half decides their level and the stated rate. If that needs more recordings than there are, the
//! limits may be extrapolated. Every alarm comes from the fleet's own core, which plays the
//! recordings at each limit of a grid.

mod choose;
mod delay;
mod fault;
mod grid;
mod halves;
mod play;
mod report;
mod request;
mod tail;

use joulebus_dataset::trial::Trial;
use joulebus_predictor::Model;
use joulebus_settings::{FleetSettings, SettingsError};
use joulebus_statistics::poisson::{upper_mean, upper_rate};
use joulebus_wire::{Sample, fnv1a};
use rayon::prelude::*;

pub use choose::Basis;
use choose::Chosen;
use delay::Faulty;
pub use delay::{Delay, Delays, Thresholds};
pub use fault::Fault;
use grid::{Curves, KEYS, STEPS};
use halves::halves;
use play::{KINDS, OTHERS, Played, Robot};
pub use report::{Calibration, Evidence, Limit};
pub use request::{CalibrateError, Request};

/// Chooses limits for the platform with index `platform` of the settings, and states their effect.
/// Each recording is played alone, as a robot of that platform with `model`.
///
/// # Errors
/// [`CalibrateError`] with the amount that is needed.
pub fn calibrate(
    settings: &FleetSettings,
    platform: usize,
    model: &Model,
    trials: &[Trial],
    request: &Request,
) -> Result<Calibration, CalibrateError> {
    let robot = Robot::new(settings, platform, model);
    let recordings = halves(trials)?;
    let [first, second] = &recordings;
    let curves = [Curves::new(&robot, first)?, Curves::new(&robot, second)?];
    let before = grid::values(robot.limits());
    let chosen = choose(&curves, before, request)?;
    let calibrated = robot.limited(grid::limits(chosen.map(|chosen| chosen.value)));
    let [chosen_on, stated_on] = [Half::new(&calibrated, first)?, Half::new(&calibrated, second)?];
    let bound = stated_on.at_most(request.confidence);
    let is_shown = chosen.iter().any(|chosen| chosen.basis == Basis::Shown);
    let is_extrapolated = bound > request.per_robot_h();
    if is_extrapolated && !request.extrapolate {
        return Err(stated_on.too_many(bound, request));
    }
    let thresholds = Thresholds::new(first, second, chosen_on.evidence().alarms);
    let faulty = Faulty::new(second, robot.settle_samples());
    Ok(Calibration {
        robots: request.robots,
        wanted_per_robot_h: request.per_robot_h(),
        confidence: request.confidence,
        // Limits chosen for a rate are known to keep that rate, not a lower one.
        at_most_per_robot_h: if is_shown && !is_extrapolated {
            request.per_robot_h()
        } else {
            bound
        },
        extrapolated: is_extrapolated,
        needed_h: 2.0 * choose::needed_h(request),
        digest: format!("{:016x}", digest(trials)),
        chosen_on: chosen_on.evidence(),
        stated_on: stated_on.evidence(),
        limits: std::array::from_fn(|kind| Limit {
            key: KEYS[kind],
            before: before[kind],
            value: chosen[kind].value,
            basis: chosen[kind].basis,
            alarms: [chosen_on.raised(kind), stated_on.raised(kind)],
        }),
        others: std::array::from_fn(|other| {
            let count =
                |half: &Half| half.played.iter().map(|played| played.others[other]).sum::<u64>();
            (OTHERS[other].name(), count(&chosen_on) + count(&stated_on))
        }),
        delays: faulty.delays(&calibrated, &thresholds)?,
        thresholds,
        faulty_recordings: faulty.len(),
        after_s: faulty.after_s(),
    })
}

fn choose(
    [first, second]: &[Curves; 2],
    before: [f64; KINDS],
    request: &Request,
) -> Result<[Chosen; KINDS], CalibrateError> {
    if let Some(shown) = choose::shown(first, second, request) {
        return Ok(shown);
    }
    if request.extrapolate && first.hours() > 0.0 && second.hours() > 0.0 {
        return choose::extrapolated(first, second, before, request);
    }
    let (hours, wanted) = (second.hours(), request.per_robot_h());
    if hours <= 0.0 {
        return Err(CalibrateError::Unscored);
    }
    let at_best = upper_mean(0, request.confidence) / hours;
    if at_best > wanted {
        return Err(CalibrateError::Hours {
            hours,
            at_best,
            wanted,
            needed_h: 2.0 * choose::needed_h(request),
            robots: request.robots,
            confidence: request.confidence,
        });
    }
    let last: [(usize, usize); KINDS] = std::array::from_fn(|kind| (kind, STEPS - 1));
    let alarms = last.map(|(kind, step)| (second.rate(kind, step) * hours).round() as u64);
    Err(CalibrateError::Alarms {
        alarms: alarms.iter().sum(),
        hours,
        at_most: second.at_most(&last, request.confidence),
        wanted,
    })
}

/// A half of the recordings, played at the limits chosen.
struct Half {
    played: Vec<Played>,
    rows: usize,
}

impl Half {
    fn new(robot: &Robot, recordings: &[Vec<Sample>]) -> Result<Self, SettingsError> {
        let played = recordings.par_iter().map(|samples| robot.play(samples, None));
        Ok(Self {
            played: played.collect::<Result<_, _>>()?,
            rows: recordings.iter().map(Vec::len).sum(),
        })
    }

    fn raised(&self, kind: usize) -> u64 {
        self.played.iter().map(|played| played.raised[kind]).sum()
    }

    fn at_most(&self, confidence: f64) -> f64 {
        let counts: Vec<u64> =
            self.played.iter().map(|played| played.raised.iter().sum()).collect();
        let hours: Vec<f64> = self.played.iter().map(|played| played.watched_s / 3600.0).collect();
        upper_rate(&counts, &hours, confidence)
    }

    fn evidence(&self) -> Evidence {
        Evidence {
            recordings: self.played.len(),
            rows: self.rows,
            hours: self.played.iter().map(|played| played.watched_s).sum::<f64>() / 3600.0,
            alarms: (0..KINDS).map(|kind| self.raised(kind)).sum(),
        }
    }

    fn too_many(&self, at_most: f64, request: &Request) -> CalibrateError {
        let Evidence { alarms, hours, .. } = self.evidence();
        CalibrateError::Alarms { alarms, hours, at_most, wanted: request.per_robot_h() }
    }
}

/// FNV-1a over times and powers of the recordings, in their order.
fn digest(trials: &[Trial]) -> u64 {
    let rows = trials.iter().flat_map(|trial| {
        let samples = trial.to_samples(play::ROBOT, halves::BASE_NS);
        samples.into_iter().map(|sample| (sample.stamp_ns, sample.power_w.to_bits()))
    });
    fnv1a(rows.flat_map(|(stamp_ns, bits)| {
        let stamp = stamp_ns.to_le_bytes().into_iter();
        stamp.chain(bits.to_le_bytes())
    }))
}
