//! Limits for a rate, from the alarms at the steps of the grid.

use super::grid::{Curves, KEYS, STEPS, limit};
use super::play::KINDS;
use super::request::{CalibrateError, Request};
use super::tail::Tail;
use joulebus_statistics::poisson::{at_most, upper_mean};

/// The source of a limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Basis {
    /// The recordings show its rate.
    Shown,
    /// Extrapolated beyond the recordings.
    Extrapolated,
    /// Kept from the config: it would have been extrapolated, but no recording reached even the
    /// lowest limit.
    Kept,
}

/// A chosen limit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Chosen {
    pub value: f64,
    pub basis: Basis,
}

/// Probability of an excess over an extrapolated tail below which the excess refutes the tail.
const REFUTED: f64 = 0.01;

/// The limits that the recordings prove. `None` if none of the possible ones is high enough.
///
/// The first half of the recordings decides the ratios of the limits: at offset 0 each has a
/// third of the allowed alarms. The second half decides the offset. All are lowered together,
/// from the highest on, while the bound of their alarms stays within the allowed rate. The order of
/// the tests does not depend on the second half, and the first failure ends them. All that passed
/// therefore hold at the confidence of one test (a fixed sequence of tests).
pub(super) fn shown(first: &Curves, second: &Curves, request: &Request) -> Option<[Chosen; KINDS]> {
    let allowed = request.per_robot_h() / KINDS as f64;
    let middle: [usize; KINDS] = std::array::from_fn(|kind| balanced(first, kind, allowed));
    let steps = |offset: isize| {
        let moved = middle.map(|step| step.saturating_add_signed(offset).min(STEPS - 1));
        std::array::from_fn(|kind| (kind, moved[kind]))
    };
    let allows = |offset: &isize| {
        let at_most = second.at_most(&steps(*offset) as &[_; KINDS], request.confidence);
        at_most <= request.per_robot_h()
    };
    let furthest = STEPS as isize;
    let offset = (-furthest..=furthest).rev().take_while(allows).last()?;
    Some(steps(offset).map(|(kind, step)| Chosen { value: limit(kind, step), basis: Basis::Shown }))
}

const fn kept(value: f64) -> Chosen {
    Chosen { value, basis: Basis::Kept }
}

/// The lowest step from which on alarms are as rare as allowed, a robot and hour.
fn balanced(curves: &Curves, kind: usize, allowed: f64) -> usize {
    let rare = (0..STEPS).rev().take_while(|step| curves.rate(kind, *step) <= allowed);
    rare.last().unwrap_or(STEPS - 1)
}

/// Limits from the tails of the first half, each for a third of the allowed alarms, and none below
/// the maximum of the first half.
///
/// # Errors
/// A tail is too heavy or too uncertain for the greatest allowed limit, or the second half refutes
/// it.
pub(super) fn extrapolated(
    first: &Curves,
    second: &Curves,
    before: [f64; KINDS],
    request: &Request,
) -> Result<[Chosen; KINDS], CalibrateError> {
    let mut chosen = before.map(kept);
    for (kind, chosen) in chosen.iter_mut().enumerate() {
        let Some(tail) = Tail::new(first, kind, request.confidence) else {
            continue;
        };
        check(&tail, second, kind)?;
        let allowed = request.per_robot_h() / KINDS as f64;
        let silent = first.0.iter().filter_map(|curve| curve.peak(kind)).max();
        let step = tail.step_for(allowed).max(silent.map_or(0, |peak| peak + 1));
        if step >= STEPS {
            return Err(CalibrateError::Tail {
                key: KEYS[kind],
                reached: tail.recordings,
                greatest: limit(kind, STEPS - 1),
                rate: tail.rate(STEPS - 1),
                wanted: allowed,
            });
        }
        *chosen = Chosen { value: limit(kind, step), basis: Basis::Extrapolated };
    }
    Ok(chosen)
}

/// Checks that the second half has no more recordings beyond any step than the tail of the first
/// allows.
fn check(tail: &Tail, second: &Curves, kind: usize) -> Result<(), CalibrateError> {
    for step in tail.from..STEPS {
        let expected = tail.rate(step) * second.hours();
        let beyond = second.0.iter().filter(|curve| curve.at(kind, step) > 0);
        let found = beyond.count() as u64;
        if found > 0 && 1.0 - at_most(found - 1, expected) < REFUTED {
            return Err(CalibrateError::Refuted {
                key: KEYS[kind],
                limit: limit(kind, step),
                expected,
                found,
            });
        }
    }
    Ok(())
}

/// Robot-hours without an alarm that prove the requested rate.
pub(super) fn needed_h(request: &Request) -> f64 {
    upper_mean(0, request.confidence) / request.per_robot_h()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::grid::Curve;
    use joulebus_statistics::noise::Noise;

    /// Share of the alarms that remains after a step, by kind.
    const DECAYS: [f64; KINDS] = [0.6, 0.5, 0.6];
    /// Alarms a robot and hour at the lowest step, by kind.
    const RATES: [f64; KINDS] = [40.0, 4.0, 15.0];

    /// Recordings of half an hour whose alarms become rarer by [`DECAYS`], each of a robot with a
    /// rate of its own: `differ` draws it, of mean 1.
    fn drawn(noise: &mut Noise, recordings: usize, differ: fn(&mut Noise) -> f64) -> Curves {
        let one = |noise: &mut Noise| {
            let mut raised = vec![[0; KINDS]; STEPS];
            let factor = differ(noise);
            for kind in 0..KINDS {
                let mut at_h = noise.waiting_s(1.0 / (factor * RATES[kind]));
                while at_h < 0.5 {
                    let height = libm::log(1.0 - noise.uniform()) / libm::log(DECAYS[kind]);
                    let reached = raised.iter_mut().take(1 + height as usize);
                    reached.for_each(|step| step[kind] += 1);
                    at_h += noise.waiting_s(1.0 / (factor * RATES[kind]));
                }
            }
            Curve { hours: 0.5, raised }
        };
        Curves((0..recordings).map(|_| one(noise)).collect())
    }

    /// True rate at the chosen limits.
    fn true_rate(chosen: &[Chosen; KINDS]) -> f64 {
        let rate = |kind: usize| {
            let step = (0..STEPS).find(|step| limit(kind, *step) == chosen[kind].value);
            RATES[kind] * DECAYS[kind].powf(step.unwrap() as f64)
        };
        (0..KINDS).map(rate).sum()
    }

    fn request(per_robot_h: f64) -> Request {
        Request { fleet_per_h: 10.0 * per_robot_h, robots: 10, confidence: 0.95, extrapolate: true }
    }

    #[test]
    fn what_is_shown_holds_in_at_least_its_share_of_draws() {
        for differ in [|_: &mut Noise| 1.0, |noise: &mut Noise| 0.5 + noise.uniform()] {
            let (mut noise, mut holds, mut uses) = (Noise::new(3, 0), 0, 0.0);
            for _ in 0..200 {
                let halves = [0, 1].map(|_| drawn(&mut noise, 16, differ));
                let chosen = shown(&halves[0], &halves[1], &request(1.5)).unwrap();
                let rate = true_rate(&chosen);
                holds += u32::from(rate <= 1.5);
                uses += rate / 1.5 / 200.0;
            }
            assert!(holds >= 190, "{holds} of 200");
            // The limits are no higher than necessary.
            assert!(uses > 0.25, "{uses}");
        }
    }

    #[test]
    fn a_continued_tail_holds_in_at_least_its_share_of_draws() {
        let (mut noise, mut holds, mut refused) = (Noise::new(4, 0), 0, 0);
        for _ in 0..200 {
            let halves = [0, 1].map(|_| drawn(&mut noise, 40, |_| 1.0));
            // 20 robot-hours show 0.15 at best.
            assert!(shown(&halves[0], &halves[1], &request(0.02)).is_none());
            match extrapolated(&halves[0], &halves[1], [1.0; KINDS], &request(0.02)) {
                Ok(chosen) => holds += u32::from(true_rate(&chosen) <= 0.02),
                Err(_) => refused += 1,
            }
        }
        assert!(refused <= 10, "{refused} of 200");
        assert!(holds >= (200 - refused) * 19 / 20, "{holds} of 200, {refused} refused");
    }

    #[test]
    fn a_tail_that_the_other_half_contradicts_is_refused() {
        let mut noise = Noise::new(5, 0);
        let [first, mut second] = [0, 1].map(|_| drawn(&mut noise, 40, |_| 1.0));
        for curve in second.0.iter_mut().take(5) {
            curve.raised[STEPS - 5..].fill([1; KINDS]);
        }
        let refused = extrapolated(&first, &second, [1.0; KINDS], &request(0.01));
        assert!(matches!(refused, Err(CalibrateError::Refuted { found: 5, .. })), "{refused:?}");
    }
}
