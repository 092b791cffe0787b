//! Budgets.

use joulebus_energy::EnergyLeft;
use joulebus_predictor::nan::canonical;
use joulebus_settings::Battery;
use joulebus_wire::{Budget, ChargeState, budget_flag};

use crate::layout::lanes::{self, Block as _, LANES, Lanes};
use crate::ledger::battery::{At, BatteryLanes, BatteryState, Charging};
use crate::ledger::counting::{Counting, Size};
use crate::ledger::remaining::{Left, LeftLanes, Remaining, RemainingLanes};
use crate::state::columns::BlockRef;
use crate::tick::context::TickContext;
use crate::tick::platform_context::PlatformContext;
use crate::tick::write::flag::flag;

/// The budgets of a block.
pub(crate) struct BudgetRows<'a> {
    block: BlockRef<'a>,
    remaining: RemainingLanes,
    mean_power_w: Lanes<f32>,
    sensor_bias: Lanes<f32>,
    sensor_bias_sd: Lanes<f32>,
    sensor_covariance: Lanes<f32>,
    pause_s: Lanes<f32>,
    pause: Lanes<f32>,
}

impl<'a> BudgetRows<'a> {
    #[inline(always)]
    pub(crate) fn new(tick: &TickContext, block: BlockRef<'a>) -> Self {
        const UNKNOWN: Lanes<f32> = [f32::NAN; LANES];
        let mut budgets = Self {
            remaining: RemainingLanes::UNKNOWN,
            block,
            mean_power_w: UNKNOWN,
            sensor_bias: UNKNOWN,
            sensor_bias_sd: UNKNOWN,
            sensor_covariance: UNKNOWN,
            pause_s: [0.0; LANES],
            pause: [0.0; LANES],
        };
        fill_remaining(tick, &mut budgets);
        for lane in 0..LANES {
            budgets.mean_power_w[lane] = canonical(block.lasts.mean_power_w[lane]);
        }
        if let Some(batteries) = block.batteries {
            for lane in 0..LANES {
                let (known, battery) = (budgets.remaining.battery[lane], batteries.get(lane));
                let value = |value: f64| if known { canonical(value as f32) } else { f32::NAN };
                let sensor = battery.sensor();
                budgets.sensor_bias[lane] = value(battery.bias);
                budgets.sensor_bias_sd[lane] = value(sensor.var.sqrt());
                budgets.sensor_covariance[lane] = value(sensor.covariance);
            }
        }
        budgets
    }

    /// The budget of the robot in a lane.
    #[inline(always)]
    pub(crate) fn get(&self, tick: &TickContext, lane: usize) -> Budget {
        let admission = &self.block.admissions[lane];
        let platform = &tick.platforms[usize::from(admission.platform)].platform;
        let ledger = self.block.ledgers.get(lane);
        let charge_state = match (admission.accepted, admission.charging) {
            (false, _) => ChargeState::Unknown,
            (true, true) => ChargeState::Charging,
            (true, false) => ChargeState::Discharging,
        };
        let stamp_ns = ledger.stamp_ns();
        let remaining = self.remaining.get(lane);
        let battery = (self.block.batteries)
            .filter(|_| remaining.battery)
            .map(|batteries| batteries.get(lane));
        let size = battery.zip(platform.battery.as_ref()).filter(|(of, _)| of.capacity_sd > 0.0);
        let size = size.map(|(of, battery)| (Size::new(battery, of.size()), of.lessons.weight));
        Budget {
            robot: admission.id,
            flags: flag(stamp_ns.is_some(), budget_flag::LEDGER)
                | flag(admission.charged, budget_flag::CHARGED)
                | flag(remaining.battery, budget_flag::BATTERY)
                | flag(!remaining.soc.is_nan(), budget_flag::CHARGE)
                | flag(!remaining.time_to_empty_s.is_nan(), budget_flag::TIME_TO_EMPTY)
                | flag(battery.is_some_and(|battery| battery.fused), budget_flag::MEASURED)
                | flag(battery.is_some_and(|battery| battery.off), budget_flag::OFF)
                | flag(
                    battery.is_some_and(|battery| battery.is_contradicted()),
                    budget_flag::CONTRADICTED,
                ),
            charge_state: charge_state.code(),
            battery_changes: battery.map_or(0, |battery| battery.changes),
            drawn_uj: ledger.drawn_uj,
            drawn_remainder: ledger.drawn_remainder.into(),
            forecast_uj: ledger.forecast_uj,
            metered_ns: ledger.metered_ns,
            unmetered_ns: ledger.unmetered_ns,
            stamp_ns: stamp_ns.unwrap_or(0),
            valid_until_ns: stamp_ns
                .map_or(0, |stamp| stamp.saturating_add(platform.stale_after_ns)),
            mean_power_w: self.mean_power_w[lane],
            left_j: remaining.left_j,
            usable_j: remaining.usable_j,
            usable_lo_j: remaining.usable_lo_j,
            soc: remaining.soc,
            soc_lo: remaining.soc_lo,
            time_to_empty_s: remaining.time_to_empty_s,
            time_to_empty_lo_s: remaining.time_to_empty_lo_s,
            time_to_empty_hi_s: remaining.time_to_empty_hi_s,
            soc_hi: remaining.soc_hi,
            soc_sd: remaining.soc_sd,
            sensor_bias: self.sensor_bias[lane],
            sensor_bias_sd: self.sensor_bias_sd[lane],
            sensor_covariance: self.sensor_covariance[lane],
            idle_w: battery.map_or(f32::NAN, |battery| canonical(battery.idle_w)),
            pause_s: self.pause_s[lane],
            pause: self.pause[lane],
            capacity_j: size.map_or(f32::NAN, |(size, _)| size.capacity_j as f32),
            capacity_sd_j: size.map_or(f32::NAN, |(size, _)| (size.capacity_j * size.sd) as f32),
            capacity_weight: size.map_or(0.0, |(_, weight)| weight),
            charge_rate: battery.map_or_else(Default::default, |of| of.lessons.charge_rate),
            reserved: 0,
        }
    }
}

/// Energy left of the robots of a block.
#[inline(always)]
fn fill_remaining(tick: &TickContext, budgets: &mut BudgetRows<'_>) {
    let block = budgets.block;
    let Some(batteries) = block.batteries else {
        return;
    };
    let (mut known, mut platform) = ([false; LANES], [0; LANES]);
    let mut silent_ns = [0; LANES];
    for (lane, admission) in block.admissions.iter().enumerate() {
        known[lane] = admission.accepted;
        platform[lane] = admission.platform;
        silent_ns[lane] = tick.silent_ns(admission);
    }
    for (number, context) in tick.platforms.iter().enumerate() {
        let Some(battery) = context.platform.battery else {
            continue;
        };
        let mut mask = known;
        for lane in 0..LANES {
            mask[lane] &= usize::from(platform[lane]) == number;
        }
        if lanes::any(&mask) {
            fill(budgets, (&battery, context), batteries, &mask, &silent_ns);
        }
    }
}

/// A battery as it is now: after the sample of the robot in a lane, and the time for which the next
/// one is overdue.
#[inline(always)]
pub(crate) fn estimate(
    block: &BlockRef<'_>,
    robot: &BatteryState,
    counting: &Counting,
    lane: usize,
    overdue_ns: u64,
) -> EnergyLeft {
    let at = At::new(&block.ledgers.get(lane)).silent_for(overdue_ns);
    // On a charger the anchor is at the last sample with a reading. The time since then counts as
    // silence.
    let charging = Charging { metered: false, unmetered: robot.charging };
    robot.now(counting, at, charging)
}

/// Computes the robots of one platform.
// The loops over lanes become vectors; iterators over three arrays do not.
#[allow(clippy::needless_range_loop)]
#[inline(always)]
fn fill(
    budgets: &mut BudgetRows<'_>,
    (battery, context): (&Battery, &PlatformContext),
    batteries: &BatteryLanes,
    mask: &Lanes<bool>,
    silent_ns: &Lanes<u64>,
) {
    let (platform, block) = (&context.platform, budgets.block);
    let counting = Counting::new(battery, platform);
    let mean_w = &block.lasts.mean_power_w;
    // Copies, and a loop for each result: the compiler knows that no result changes what is read.
    let (battery, mut left) = (*battery, LeftLanes::UNKNOWN);
    let (mut remaining, mut pauses) = (RemainingLanes::UNKNOWN, [[0.0; LANES]; 2]);
    let mut overdue_ns = [0; LANES];
    for lane in 0..LANES {
        overdue_ns[lane] = silent_ns[lane].saturating_sub(platform.period_ns);
    }
    for lane in 0..LANES {
        let robot = batteries.get(lane);
        let estimate = estimate(&block, &robot, &counting, lane, overdue_ns[lane]);
        left.set(lane, true, Left::from(estimate));
    }
    for lane in 0..LANES {
        let robot = batteries.get(lane);
        let at = At::new(&block.ledgers.get(lane)).silent_for(overdue_ns[lane]);
        (pauses[0][lane], pauses[1][lane]) = robot.paused(&counting, at);
    }
    let of_robot = |lane: usize| {
        let robot = batteries.get(lane);
        (Size::new(&battery, robot.size()), left.get(lane).into(), robot.charging)
    };
    match &context.lasting {
        Some(lasting) => {
            for lane in 0..LANES {
                let (size, estimate, charging) = of_robot(lane);
                let longest = block.energy.longest_level(lane);
                let power = lasting.of(longest, context.errors.platform());
                let range_w = |seconds| power.range_w(seconds);
                let left = (&battery, &size);
                let robot = Remaining::new(left, &estimate, power.mean_w, range_w, charging);
                remaining.set(lane, true, robot);
            }
        }
        // What is known of the next reading, in place of hours.
        None => {
            for lane in 0..LANES {
                let (size, estimate, charging) = of_robot(lane);
                let (lo_w, hi_w) = block.intervals.get(lane).around(mean_w[lane], 0, true);
                let (left, range_w) = ((&battery, &size), |_| [lo_w, hi_w]);
                let robot = Remaining::new(left, &estimate, mean_w[lane], range_w, charging);
                remaining.set(lane, true, robot);
            }
        }
    }
    for lane in 0..LANES {
        budgets.remaining.set(lane, mask[lane], remaining.get(lane));
        lanes::put(&mut budgets.pause_s[lane], mask[lane], pauses[0][lane]);
        lanes::put(&mut budgets.pause[lane], mask[lane], pauses[1][lane]);
    }
}
