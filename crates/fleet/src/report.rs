//! What the tick says of each robot, in the form in which it lies in shared memory.

use joulebus_wire::{
    Alarm, AlarmSet, Budget, ChargeState, Diagnostic, Forecast, InvalidReason, Level, Quality,
    budget_flag, diagnostic_flag, forecast_flag,
};

use crate::detector::Detector;
use crate::interval::Interval;
use crate::pass::Rules;
use crate::robot::{Gate, Last};
use crate::window::Window;
use crate::{Battery, Ledger, Platform, Scores};

/// The state of one robot.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Seen<'a> {
    pub gate: &'a Gate,
    pub last: &'a Last,
    pub window: &'a Window,
    pub interval: &'a Interval,
    pub ledger: &'a Ledger,
    pub scores: &'a Scores,
    pub detector: &'a Detector,
}

/// The flag, if it holds.
const fn flag(holds: bool, flag: u32) -> u32 {
    if holds { flag } else { 0 }
}

/// The forecast of a robot.
#[inline]
pub(crate) fn forecast(rules: &Rules<'_>, seen: &Seen<'_>) -> Forecast {
    let (gate, last) = (seen.gate, seen.last);
    let (window, platform) = (seen.window, platform(rules, gate));
    let (power_w, open_steps) = window.shown();
    let quality = quality(rules, gate, last, power_w, open_steps);
    let known = matches!(
        quality,
        Quality::Fresh | Quality::Held | Quality::OpenLoop { .. }
    );
    let (lo_w, hi_w) = seen
        .interval
        .around(power_w, open_steps, window.shown_due());
    let (code, detail) = quality.encode();
    // A robot that runs open loop by the worker's clock is forecast further ahead.
    let ahead = 1 + u64::from(open_steps.saturating_sub(window.unread_steps));
    let watts = |value: f32| if known { value } else { f32::NAN };
    Forecast {
        robot: gate.id,
        flags: flag(known, forecast_flag::POWER | forecast_flag::INTERVAL)
            | flag(!last.reading_w.is_nan(), forecast_flag::READING)
            | flag(gate.accepted, forecast_flag::SAMPLE),
        quality: code,
        quality_detail: detail,
        reading_w: last.reading_w,
        power_w: watts(power_w),
        lo_w: watts(lo_w),
        hi_w: watts(hi_w),
        generation: gate.generation,
        sample_seq: last.seq,
        stamp_ns: gate.stamp_ns,
        target_ns: gate.stamp_ns.saturating_add(ahead * platform.period_ns),
        reading_age_ns: gate.stamp_ns.saturating_sub(last.measured_ns),
        source_epoch: gate.source_epoch,
    }
}

/// The diagnostics of a robot.
#[inline]
pub(crate) fn diagnostic(rules: &Rules<'_>, seen: &Seen<'_>) -> Diagnostic {
    let (gate, last) = (seen.gate, seen.last);
    let (scores, detector) = (seen.scores, seen.detector);
    let kind = &rules.kinds[usize::from(gate.platform)];
    let raised = detector.raised();
    let alarms = if is_stale(rules, gate) {
        raised.with(Alarm::NoData)
    } else {
        raised
    };
    let (level, first) = most_important(alarms);
    let (coverage, coverage_recent) = seen.interval.coverage(scores.count);
    Diagnostic {
        robot: gate.id,
        flags: flag(!last.residual_w.is_nan(), diagnostic_flag::RESIDUAL)
            | flag(scores.count > 0, diagnostic_flag::SCORES),
        level,
        alarm: first,
        alarms: alarms.0,
        residual_w: last.residual_w,
        residual_z: last.residual_w / kind.sigma_w,
        bias_w: detector.bias_w,
        cusum_up: detector.cusum_up,
        cusum_down: detector.cusum_down,
        noise_ratio: detector.noise_ratio,
        coverage,
        coverage_recent,
        scored: scores.count,
        mae_w: scores.mae_w(),
        r2: scores.r2(),
        persistence_mae_w: scores.persistence_mae_w(),
        persistence_r2: scores.persistence_r2(),
        skill: scores.skill(),
        sample_seq: last.seq,
        stamp_ns: gate.stamp_ns,
        source_epoch: gate.source_epoch,
        refused: last.refused,
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

/// The budget of a robot.
#[inline]
pub(crate) fn budget(rules: &Rules<'_>, seen: &Seen<'_>) -> Budget {
    let (gate, last) = (seen.gate, seen.last);
    let (ledger, platform) = (seen.ledger, platform(rules, gate));
    let charge_state = match (gate.accepted, gate.charging) {
        (false, _) => ChargeState::Unknown,
        (true, true) => ChargeState::Charging,
        (true, false) => ChargeState::Discharging,
    };
    let stamp_ns = ledger.stamp_ns();
    let budget = Budget {
        robot: gate.id,
        flags: flag(stamp_ns.is_some(), budget_flag::LEDGER)
            | flag(gate.charged, budget_flag::CHARGED),
        charge_state: charge_state.code(),
        reserved: 0,
        drawn_uj: ledger.drawn_uj,
        drawn_remainder: ledger.drawn_remainder.into(),
        forecast_uj: ledger.forecast_uj,
        metered_ns: ledger.metered_ns,
        unmetered_ns: ledger.unmetered_ns,
        stamp_ns: stamp_ns.unwrap_or(0),
        valid_until_ns: stamp_ns.map_or(0, |stamp| stamp.saturating_add(platform.stale_after_ns)),
        mean_power_w: last.mean_power_w,
        left_j: f32::NAN,
        usable_j: f32::NAN,
        usable_lo_j: f32::NAN,
        soc: f32::NAN,
        soc_lo: f32::NAN,
        time_to_empty_s: f32::NAN,
        time_to_empty_lo_s: f32::NAN,
        time_to_empty_hi_s: f32::NAN,
        reserved2: 0,
    };
    match &platform.battery {
        // How much a charger has put back is not known: better no figure than a wrong one.
        Some(battery) if !gate.charged && gate.accepted => {
            let silent_ns = rules
                .now_ns
                .saturating_sub(gate.taken_ns)
                .saturating_sub(platform.period_ns);
            let (lo_w, hi_w) = seen.interval.around(budget.mean_power_w, 0, true);
            with_battery(budget, battery, platform, silent_ns, (lo_w, hi_w))
        }
        _ => budget,
    }
}

/// With what is left in the battery; `ends_w`: the interval around the mean power.
#[inline]
fn with_battery(
    mut budget: Budget,
    battery: &Battery,
    platform: &Platform,
    silent_ns: u64,
    ends_w: (f32, f32),
) -> Budget {
    let capacity_j = battery.capacity_j;
    let drawn_j = budget.drawn_j();
    let unmetered_s = budget.unmetered_ns.saturating_add(silent_ns) as f64 * 1e-9;
    let mean_w = f64::from(budget.mean_power_w).max(0.0);
    let left_j = capacity_j * battery.initial_soc - drawn_j - unmetered_s * mean_w;
    // On the safe side, nobody looked: the robot may have drawn all that it can.
    let worst_w = f64::from(platform.power_max_w).max(0.0);
    let left_lo_j = capacity_j * battery.initial_soc_lo - drawn_j - unmetered_s * worst_w;
    // Regeneration fills a battery no further than full.
    let (left_j, left_lo_j) = (left_j.min(capacity_j), left_lo_j.min(capacity_j));
    let reserve_j = capacity_j * battery.reserve;
    let share = |joules: f64| (joules / capacity_j).clamp(0.0, 1.0) as f32;
    let usable_j = (left_j - reserve_j).max(0.0);
    let usable_lo_j = (left_lo_j - reserve_j).max(0.0);
    budget.flags |= budget_flag::BATTERY;
    budget.left_j = left_j.max(0.0) as f32;
    budget.usable_j = usable_j as f32;
    budget.usable_lo_j = usable_lo_j as f32;
    (budget.soc, budget.soc_lo) = (share(left_j), share(left_lo_j));
    let (lo_w, hi_w) = ends_w;
    // Under a lasting bias the interval lies beside the forecast; the safe side stays safe.
    let (lo_w, hi_w) = (f64::from(lo_w).min(mean_w), f64::from(hi_w).max(mean_w));
    if mean_w > 0.0 {
        budget.flags |= budget_flag::TIME_TO_EMPTY;
        budget.time_to_empty_s = (usable_j / mean_w) as f32;
        budget.time_to_empty_lo_s = (usable_lo_j / hi_w) as f32;
        budget.time_to_empty_hi_s = if lo_w > 0.0 {
            (usable_j / lo_w) as f32
        } else {
            f32::INFINITY
        };
    }
    budget
}

fn platform<'a>(rules: &Rules<'a>, gate: &Gate) -> &'a Platform {
    &rules.kinds[usize::from(gate.platform)].platform
}

fn is_stale(rules: &Rules<'_>, gate: &Gate) -> bool {
    rules.now_ns.saturating_sub(gate.taken_ns) > platform(rules, gate).stale_after_ns
}

fn quality(rules: &Rules<'_>, gate: &Gate, last: &Last, power_w: f32, open_steps: u16) -> Quality {
    if is_stale(rules, gate) {
        return Quality::Invalid(InvalidReason::Stale);
    }
    if let Some(reason) = gate.invalid {
        return Quality::Invalid(reason);
    }
    match last.quality {
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
