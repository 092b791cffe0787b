//! Writes the starts of plans.

use joulebus_wire::{Alarm, AlarmSet, PlanState, plan_state_flag};

use crate::layout::lanes::Block as _;
use crate::state::columns::BlockRef;
use crate::tick::context::TickContext;
use crate::tick::write::flag::flag;
use crate::tick::write::forecasts::quality_of;
use crate::tick::write::learned::LearnedLanes;

/// The plan states of a block.
pub(crate) struct PlanStateRows<'a, 'b> {
    block: BlockRef<'a>,
    learned: &'b LearnedLanes,
}

impl<'a, 'b> PlanStateRows<'a, 'b> {
    #[inline(always)]
    pub(crate) fn new(block: BlockRef<'a>, learned: &'b LearnedLanes) -> Self {
        Self { block, learned }
    }

    /// The plan state of the robot in a lane. Windows, intervals and energy states hold no NaN but
    /// the canonical one: those are not computed with.
    #[inline(always)]
    pub(crate) fn get(&self, tick: &TickContext, lane: usize) -> PlanState {
        let admission = &self.block.admissions[lane];
        let start = self.block.windows.get(lane).plan_start();
        let interval = self.block.intervals.get(lane).scale();
        let errors = &tick.platforms[usize::from(admission.platform)].errors;
        let energy = self.block.energy.state(lane, errors);
        // Of an emptied window, too, the last sample's.
        let (v_mps, omega_radps) = energy.command();
        let shown = (start.power_w, start.steps);
        let (quality, quality_detail) = quality_of(tick, &self.block, lane, shown);
        let (learns, learned) = self.learned.get(lane);
        let [weight_last, weight_network, weight_stack] = learned.weights;
        let [_, held_weight_stack] = learned.held_weights;
        let [gain_last, gain_network, gain_mean] = learned.gains;
        let [lag1_w, lag2_w, lag3_w, lag4_w, lag5_w] = start.lag_w;
        let [age_steps, interval_steps] = start.reading_age.to_bytes().map(u16::from);
        let outside = admission.outside_training;
        let of_battery = self.block.batteries.map_or(0, |batteries| batteries.raised[lane]);
        let raised = self.block.detectors.raised(lane).and(AlarmSet(of_battery));
        PlanState {
            robot: admission.id,
            flags: flag(admission.accepted, plan_state_flag::SAMPLE)
                | flag(start.is_full, plan_state_flag::LAGS)
                | flag(start.commanded, plan_state_flag::COMMAND)
                | flag(start.reading_age.is_known(), plan_state_flag::READING_AGE)
                | flag(learns, plan_state_flag::LEARNED)
                | flag(outside, plan_state_flag::OUTSIDE_TRAINING)
                | flag(tick.is_stale(admission), plan_state_flag::ALARM_NO_DATA)
                | flag(raised.has(Alarm::OutOfRange), plan_state_flag::ALARM_OUT_OF_RANGE)
                | flag(raised.has(Alarm::StuckSensor), plan_state_flag::ALARM_STUCK_SENSOR)
                | flag(raised.has(Alarm::HeldTooLong), plan_state_flag::ALARM_HELD_TOO_LONG)
                | flag(raised.has(Alarm::SocImplausible), plan_state_flag::ALARM_SOC_IMPLAUSIBLE)
                | flag(admission.implausible, plan_state_flag::ALARM_IMPLAUSIBLE),
            quality,
            quality_detail,
            platform: admission.platform,
            open_steps: start.steps,
            age_steps,
            interval_steps,
            generation: admission.generation,
            stamp_ns: admission.stamp_ns,
            v_mps,
            omega_radps,
            lag1_w,
            lag2_w,
            lag3_w,
            lag4_w,
            lag5_w,
            network_w: learned.network_w,
            mean_w: learned.mean_w,
            change_w: learned.change_w,
            weight_last,
            weight_network,
            weight_stack,
            held_weight_stack,
            gain_last,
            gain_network,
            gain_mean,
            level_w: learned.level_w,
            size_due_w: interval.due.size_w,
            below_due: interval.due.below,
            above_due: interval.due.above,
            size_held_w: interval.held.size_w,
            below_held: interval.held.below,
            above_held: interval.held.above,
            energy_j: energy.metered.energy_j,
            command_j: energy.metered.command_j,
            time_s: energy.metered.time_s,
            error_lower: energy.bounds.lower,
            error_upper: energy.bounds.upper,
            command_trust: energy.learned.command_trust,
            reserved: 0,
        }
    }
}
