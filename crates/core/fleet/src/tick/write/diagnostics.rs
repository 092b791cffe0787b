//! Diagnostics.

// Index loops: the compiler vectorises them.
#![allow(clippy::needless_range_loop)]

use joulebus_predictor::nan::canonical;
use joulebus_wire::{Alarm, AlarmSet, Diagnostic, Level, diagnostic_flag};

use crate::layout::lanes::{Block as _, LANES, Lanes};
use crate::ledger::counting::{Counting, Size};
use crate::ledger::levels;
use crate::state::columns::BlockRef;
use crate::tick::context::TickContext;
use crate::tick::write::budgets;
use crate::tick::write::flag::flag;
use crate::tick::write::learned::LearnedLanes;

/// The diagnostics of a block.
pub(crate) struct DiagnosticRows<'a, 'b> {
    block: BlockRef<'a>,
    mae_w: Lanes<f64>,
    r2: Lanes<f64>,
    persistence_mae_w: Lanes<f64>,
    persistence_r2: Lanes<f64>,
    skill: Lanes<f64>,
    coverage: Lanes<f32>,
    coverage_recent: Lanes<f32>,
    residual_w: Lanes<f32>,
    bias_w: Lanes<f32>,
    noise_ratio: Lanes<f32>,
    learned: &'b LearnedLanes,
}

impl<'a, 'b> DiagnosticRows<'a, 'b> {
    #[inline(always)]
    pub(crate) fn new(block: BlockRef<'a>, learned: &'b LearnedLanes) -> Self {
        let mut diagnostics = Self {
            block,
            mae_w: [0.0; LANES],
            r2: [0.0; LANES],
            persistence_mae_w: [0.0; LANES],
            persistence_r2: [0.0; LANES],
            skill: [0.0; LANES],
            coverage: [0.0; LANES],
            coverage_recent: [0.0; LANES],
            residual_w: [0.0; LANES],
            bias_w: [0.0; LANES],
            noise_ratio: [0.0; LANES],
            learned,
        };
        for lane in 0..LANES {
            let scores = block.scores.get(lane);
            diagnostics.mae_w[lane] = scores.mae_w();
            diagnostics.r2[lane] = scores.r2();
            diagnostics.persistence_mae_w[lane] = scores.persistence_mae_w();
            diagnostics.persistence_r2[lane] = scores.persistence_r2();
            diagnostics.skill[lane] = scores.skill();
            let (over_all, recent) = block.intervals.get(lane).coverage(scores.share());
            diagnostics.coverage[lane] = canonical(over_all);
            diagnostics.coverage_recent[lane] = canonical(recent);
        }
        let detectors = block.detectors;
        for lane in 0..LANES {
            diagnostics.residual_w[lane] = canonical(block.lasts.residual_w[lane]);
            diagnostics.bias_w[lane] = canonical(detectors.bias_w[lane]);
            diagnostics.noise_ratio[lane] = canonical(detectors.noise_ratio[lane]);
        }
        diagnostics
    }

    /// The diagnostics of the robot in a lane.
    #[inline(always)]
    pub(crate) fn get(&self, tick: &TickContext, lane: usize) -> Diagnostic {
        let (admission, last) = (&self.block.admissions[lane], self.block.lasts.get(lane));
        let (scored, detectors) = (self.block.scores.count[lane], self.block.detectors);
        let context = &tick.platforms[usize::from(admission.platform)];
        let of_battery = battery_levels(tick, &self.block, lane);
        let of_level = self.block.levels.map_or(AlarmSet(0), |levels| levels.alarms(lane));
        let raised = detectors.raised(lane).and(AlarmSet(of_battery)).and(of_level);
        let alarms = if tick.is_stale(admission) { raised.with(Alarm::NoData) } else { raised };
        let (level, first) = most_important(alarms);
        let (learns, learned) = self.learned.get(lane);
        let ([weight_last, weight_network, weight_stack], [held_weight_last, held_weight_stack]) =
            (learned.weights, learned.held_weights);
        let [gain_last, gain_network, gain_mean] = learned.gains;
        Diagnostic {
            robot: admission.id,
            flags: flag(!last.residual_w.is_nan(), diagnostic_flag::RESIDUAL)
                | flag(scored > 0, diagnostic_flag::SCORES)
                | flag(learns, diagnostic_flag::LEARNED),
            level,
            alarm: first,
            alarms: alarms.0,
            residual_w: self.residual_w[lane],
            residual_z: canonical(last.residual_w * context.per_sigma),
            bias_w: self.bias_w[lane],
            cusum_up: f32::NAN,
            cusum_down: f32::NAN,
            noise_ratio: self.noise_ratio[lane],
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
            network_w: learned.network_w,
            mean_w: learned.mean_w,
            change_w: learned.change_w,
            weight_last,
            weight_network,
            weight_stack,
            held_weight_last,
            held_weight_stack,
            gain_last,
            gain_network,
            gain_mean,
            level_w: learned.level_w,
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

/// The alarms of a battery: those of the last sample. While the next sample is overdue, those by
/// this tick's budget, which falls all the time.
#[inline(always)]
fn battery_levels(tick: &TickContext, block: &BlockRef<'_>, lane: usize) -> u32 {
    let admission = &block.admissions[lane];
    let platform = &tick.platforms[usize::from(admission.platform)].platform;
    let (Some(batteries), Some(battery)) = (block.batteries, &platform.battery) else {
        return 0;
    };
    let overdue_ns = tick.silent_ns(admission).saturating_sub(platform.period_ns);
    if overdue_ns == 0 || !admission.accepted {
        return batteries.raised[lane];
    }
    let (robot, counting) = (batteries.get(lane), Counting::new(battery, platform));
    let estimate = budgets::estimate(block, &robot, &counting, lane, overdue_ns);
    levels::judge(
        robot.raised,
        (battery, &Size::new(battery, robot.size())),
        &estimate,
        robot.return_j,
    )
}

/// Codes of the worst level and of the most important alarm of a set, without iterating over it.
fn most_important(alarms: AlarmSet) -> (u16, u16) {
    let (level, worst) = match alarms.0 {
        bits if bits & STALE != 0 => (Level::Stale, bits & STALE),
        bits if bits & ERROR != 0 => (Level::Error, bits & ERROR),
        bits if bits & WARN != 0 => (Level::Warn, bits & WARN),
        bits => (Level::Ok, bits),
    };
    // The first of a set is its lowest bit, and the code of an alarm is the bit's position plus 1.
    let first = match worst {
        0 => Alarm::None.code(),
        bits => bits.trailing_zeros() as u16 + 1,
    };
    (level.code(), first)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fast_search_of_the_worst_alarm_is_right_for_every_set() {
        for bits in 0..1 << Alarm::ALL.len() {
            let set = AlarmSet(bits);
            let expected = (set.level().code(), set.first().code());
            assert_eq!(most_important(set), expected, "{bits:b}");
        }
    }
}
