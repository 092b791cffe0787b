//! What the tick says of each robot, in the form in which it lies in shared memory: what takes
//! arithmetic a block of robots at a time, and then robot by robot into its place.

use joulebus_wire::{
    Alarm, AlarmSet, Budget, ChargeState, Diagnostic, Forecast, InvalidReason, Level, Quality,
    budget_flag, diagnostic_flag, forecast_flag,
};

use crate::alarms::detector::DetectorLanes;
use crate::estimate::interval::IntervalLanes;
use crate::estimate::scores::ScoreLanes;
use crate::estimate::window::WindowLanes;
use crate::ingest::robot::{AdmissionState, LastLanes};
use crate::layout::lanes::{self, Block as _, LANES, Lanes};
use crate::ledger::energy::LedgerLanes;
use crate::ledger::remaining::RemainingLanes;
use crate::tick::features::Rules;

/// The state of a block of robots.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Seen<'a> {
    pub admissions: &'a [AdmissionState; LANES],
    pub lasts: &'a LastLanes,
    pub windows: &'a WindowLanes,
    pub intervals: &'a IntervalLanes,
    pub ledgers: &'a LedgerLanes,
    pub scores: &'a ScoreLanes,
    pub detectors: &'a DetectorLanes,
}

/// The flag, if it holds.
const fn flag(holds: bool, flag: u32) -> u32 {
    if holds { flag } else { 0 }
}

/// The forecasts of a block.
pub(crate) struct Forecasts<'a> {
    seen: Seen<'a>,
    power_w: Lanes<f32>,
    open_steps: Lanes<u16>,
    lo_w: Lanes<f32>,
    hi_w: Lanes<f32>,
    /// Whether it is a forecast from a reading, as far as that does not depend on the time.
    plain: Lanes<bool>,
}

impl<'a> Forecasts<'a> {
    #[inline(always)]
    pub(crate) fn of(seen: Seen<'a>) -> Self {
        let (mut power_w, mut open_steps) = ([0.0; LANES], [0; LANES]);
        let mut due = [false; LANES];
        for lane in 0..LANES {
            (power_w[lane], open_steps[lane]) = seen.windows.get(lane).shown();
        }
        let mut open = [false; LANES];
        for lane in 0..LANES {
            due[lane] = seen.windows.get(lane).due();
            open[lane] = seen.windows.is_open(lane);
        }
        if lanes::any(&open) {
            for lane in (0..LANES).filter(|lane| open[*lane]) {
                due[lane] = seen.windows.get(lane).shown_due();
            }
        }
        let (mut lo_w, mut hi_w) = ([0.0; LANES], [0.0; LANES]);
        for lane in 0..LANES {
            let interval = seen.intervals.get(lane);
            let ends_w = interval.around(power_w[lane], open_steps[lane], due[lane]);
            (lo_w[lane], hi_w[lane]) = ends_w;
        }
        let mut plain = [false; LANES];
        for lane in 0..LANES {
            let (code, _) = seen.lasts.quality(lane);
            let read = (code == FRESH) | (code == HELD);
            plain[lane] = read & power_w[lane].is_finite() & (open_steps[lane] == 0);
        }
        Self {
            seen,
            power_w,
            open_steps,
            lo_w,
            hi_w,
            plain,
        }
    }

    /// The robot's in a lane.
    #[inline(always)]
    pub(crate) fn get(&self, rules: &Rules<'_>, lane: usize) -> Forecast {
        let (admission, last) = (&self.seen.admissions[lane], self.seen.lasts.get(lane));
        let platform = &rules.contexts[usize::from(admission.platform)].platform;
        let now = self.plain[lane] & admission.invalid.is_none() & !is_stale(rules, admission);
        let (known, (quality, quality_detail), ahead) = if now {
            (true, (last.quality, last.quality_detail), 1)
        } else {
            self.otherwise(rules, lane)
        };
        let watts = |value: f32| if known { value } else { f32::NAN };
        Forecast {
            robot: admission.id,
            flags: flag(known, forecast_flag::POWER | forecast_flag::INTERVAL)
                | flag(!last.reading_w.is_nan(), forecast_flag::READING)
                | flag(admission.accepted, forecast_flag::SAMPLE),
            quality,
            quality_detail,
            reading_w: last.reading_w,
            power_w: watts(self.power_w[lane]),
            lo_w: watts(self.lo_w[lane]),
            hi_w: watts(self.hi_w[lane]),
            generation: admission.generation,
            sample_seq: last.seq,
            stamp_ns: admission.stamp_ns,
            target_ns: admission
                .stamp_ns
                .saturating_add(ahead * platform.period_ns),
            reading_age_ns: admission.stamp_ns.saturating_sub(last.measured_ns),
            source_epoch: admission.source_epoch,
        }
    }

    /// Of a robot whose forecast is not from a reading, or none: whether there is one, its quality, and
    /// how many sample periods it lies ahead.
    #[cold]
    #[inline(never)]
    fn otherwise(&self, rules: &Rules<'_>, lane: usize) -> (bool, (u16, u16), u64) {
        let (code, detail) = self.seen.lasts.quality(lane);
        let (power_w, open_steps) = (self.power_w[lane], self.open_steps[lane]);
        let made = Quality::decode(code, detail);
        let quality = quality_now(
            rules,
            &self.seen.admissions[lane],
            made,
            power_w,
            open_steps,
        );
        let known = matches!(
            quality,
            Quality::Fresh | Quality::Held | Quality::OpenLoop { .. }
        );
        // A robot that runs open loop by the worker's clock is forecast further ahead.
        let read_steps = self.seen.windows.get(lane).unread_steps;
        let ahead = 1 + u64::from(open_steps.saturating_sub(read_steps));
        (known, quality.encode(), ahead)
    }
}

const FRESH: u16 = Quality::Fresh.encode().0;
const HELD: u16 = Quality::Held.encode().0;

/// The diagnostics of a block.
pub(crate) struct Diagnostics<'a> {
    seen: Seen<'a>,
    mae_w: Lanes<f64>,
    r2: Lanes<f64>,
    persistence_mae_w: Lanes<f64>,
    persistence_r2: Lanes<f64>,
    skill: Lanes<f64>,
    coverage: Lanes<f32>,
    coverage_recent: Lanes<f32>,
}

impl<'a> Diagnostics<'a> {
    #[inline(always)]
    pub(crate) fn of(seen: Seen<'a>) -> Self {
        let mut its = Self {
            seen,
            mae_w: [0.0; LANES],
            r2: [0.0; LANES],
            persistence_mae_w: [0.0; LANES],
            persistence_r2: [0.0; LANES],
            skill: [0.0; LANES],
            coverage: [0.0; LANES],
            coverage_recent: [0.0; LANES],
        };
        for lane in 0..LANES {
            let scores = seen.scores.get(lane);
            its.mae_w[lane] = scores.mae_w();
            its.r2[lane] = scores.r2();
            its.persistence_mae_w[lane] = scores.persistence_mae_w();
            its.persistence_r2[lane] = scores.persistence_r2();
            its.skill[lane] = scores.skill();
        }
        for lane in 0..LANES {
            let observed = seen.scores.count[lane];
            let coverage = seen.intervals.get(lane).coverage(observed);
            (its.coverage[lane], its.coverage_recent[lane]) = coverage;
        }
        its
    }

    /// The robot's in a lane.
    #[inline(always)]
    pub(crate) fn get(&self, rules: &Rules<'_>, lane: usize) -> Diagnostic {
        let (admission, last) = (&self.seen.admissions[lane], self.seen.lasts.get(lane));
        let (scored, detectors) = (self.seen.scores.count[lane], self.seen.detectors);
        let context = &rules.contexts[usize::from(admission.platform)];
        let raised = detectors.raised(lane);
        let alarms = if is_stale(rules, admission) {
            raised.with(Alarm::NoData)
        } else {
            raised
        };
        let (level, first) = most_important(alarms);
        Diagnostic {
            robot: admission.id,
            flags: flag(!last.residual_w.is_nan(), diagnostic_flag::RESIDUAL)
                | flag(scored > 0, diagnostic_flag::SCORES),
            level,
            alarm: first,
            alarms: alarms.0,
            residual_w: last.residual_w,
            residual_z: last.residual_w / context.sigma_w,
            bias_w: detectors.bias_w[lane],
            cusum_up: detectors.cusum_up[lane],
            cusum_down: detectors.cusum_down[lane],
            noise_ratio: detectors.noise_ratio[lane],
            coverage: self.coverage[lane],
            coverage_recent: self.coverage_recent[lane],
            scored,
            mae_w: self.mae_w[lane],
            r2: self.r2[lane],
            persistence_mae_w: self.persistence_mae_w[lane],
            persistence_r2: self.persistence_r2[lane],
            skill: self.skill[lane],
            sample_seq: last.seq,
            stamp_ns: admission.stamp_ns,
            source_epoch: admission.source_epoch,
            refused: last.refused,
        }
    }
}

/// Alarms of one level, as bits.
const fn of_level(level: Level) -> u32 {
    let (mut bits, mut place) = (0, 0);
    while place < Alarm::ALL.len() {
        if Alarm::ALL[place].level().code() == level.code() {
            bits |= AlarmSet(0).with(Alarm::ALL[place]).0;
        }
        place += 1;
    }
    bits
}

const STALE: u32 = of_level(Level::Stale);
const ERROR: u32 = of_level(Level::Error);
const WARN: u32 = of_level(Level::Warn);

/// Codes of the worst level and of the most important alarm of a set, without going through all.
fn most_important(alarms: AlarmSet) -> (u16, u16) {
    let level = match alarms.0 {
        bits if bits & STALE != 0 => Level::Stale,
        bits if bits & ERROR != 0 => Level::Error,
        bits if bits & WARN != 0 => Level::Warn,
        _ => Level::Ok,
    };
    // The first of a set is its lowest bit, and the code of an alarm is its bit's place plus 1.
    let first = match alarms.0 {
        0 => Alarm::None.code(),
        bits => bits.trailing_zeros() as u16 + 1,
    };
    (level.code(), first)
}

/// The budgets of a block.
pub(crate) struct Budgets<'a> {
    seen: Seen<'a>,
    remaining: RemainingLanes,
}

impl<'a> Budgets<'a> {
    #[inline(always)]
    pub(crate) fn of(rules: &Rules<'_>, seen: Seen<'a>) -> Self {
        let remaining = RemainingLanes::of(rules, &seen);
        Self { seen, remaining }
    }

    /// The robot's in a lane.
    #[inline(always)]
    pub(crate) fn get(&self, rules: &Rules<'_>, lane: usize) -> Budget {
        let (admission, last) = (&self.seen.admissions[lane], self.seen.lasts.get(lane));
        let platform = &rules.contexts[usize::from(admission.platform)].platform;
        let ledger = self.seen.ledgers.get(lane);
        let charge_state = match (admission.accepted, admission.charging) {
            (false, _) => ChargeState::Unknown,
            (true, true) => ChargeState::Charging,
            (true, false) => ChargeState::Discharging,
        };
        let stamp_ns = ledger.stamp_ns();
        let remaining = self.remaining.get(lane);
        Budget {
            robot: admission.id,
            flags: flag(stamp_ns.is_some(), budget_flag::LEDGER)
                | flag(admission.charged, budget_flag::CHARGED)
                | flag(remaining.battery, budget_flag::BATTERY)
                | flag(
                    !remaining.time_to_empty_s.is_nan(),
                    budget_flag::TIME_TO_EMPTY,
                ),
            charge_state: charge_state.code(),
            reserved: 0,
            drawn_uj: ledger.drawn_uj,
            drawn_remainder: ledger.drawn_remainder.into(),
            forecast_uj: ledger.forecast_uj,
            metered_ns: ledger.metered_ns,
            unmetered_ns: ledger.unmetered_ns,
            stamp_ns: stamp_ns.unwrap_or(0),
            valid_until_ns: stamp_ns
                .map_or(0, |stamp| stamp.saturating_add(platform.stale_after_ns)),
            mean_power_w: last.mean_power_w,
            left_j: remaining.left_j,
            usable_j: remaining.usable_j,
            usable_lo_j: remaining.usable_lo_j,
            soc: remaining.soc,
            soc_lo: remaining.soc_lo,
            time_to_empty_s: remaining.time_to_empty_s,
            time_to_empty_lo_s: remaining.time_to_empty_lo_s,
            time_to_empty_hi_s: remaining.time_to_empty_hi_s,
            reserved2: 0,
        }
    }
}

#[inline(always)]
fn is_stale(rules: &Rules<'_>, admission: &AdmissionState) -> bool {
    rules.now_ns.saturating_sub(admission.taken_ns)
        > rules.contexts[usize::from(admission.platform)]
            .platform
            .stale_after_ns
}

fn quality_now(
    rules: &Rules<'_>,
    admission: &AdmissionState,
    quality: Quality,
    power_w: f32,
    open_steps: u16,
) -> Quality {
    if is_stale(rules, admission) {
        return Quality::Invalid(InvalidReason::Stale);
    }
    if let Some(reason) = admission.invalid {
        return Quality::Invalid(reason);
    }
    match quality {
        quality @ (Quality::Warmup { .. } | Quality::Invalid(_) | Quality::Unknown) => quality,
        _ if !power_w.is_finite() => Quality::Invalid(InvalidReason::ModelOutput),
        _ if open_steps > 0 => Quality::OpenLoop { steps: open_steps },
        quality => quality,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_short_way_to_the_worst_alarm_names_the_same_for_every_set() {
        for bits in 0..1 << Alarm::ALL.len() {
            let set = AlarmSet(bits);
            let expected = (set.level().code(), set.first().code());
            assert_eq!(most_important(set), expected, "{bits:b}");
        }
    }
}
