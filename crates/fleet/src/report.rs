//! What the tick says of each robot, in the form in which it lies in shared memory.

use joulebus_wire::{
    Alarm, AlarmSet, Budget, ChargeState, Diagnostic, Forecast, InvalidReason, Quality, Refusal,
    budget_flag, diagnostic_flag, forecast_flag,
};

use crate::robot::Robot;
use crate::{Battery, Fleet, Platform};

impl Fleet {
    /// The forecast of the robot at `place` (0 to [`Fleet::len`] − 1), as of the last tick.
    #[must_use]
    pub fn forecast(&self, place: usize) -> Forecast {
        let (slot, robot, platform) = self.at(place);
        let last = &robot.last;
        let (power_w, open_steps) = self.windows[slot].shown();
        let quality = self.quality(robot, power_w, open_steps);
        let known = matches!(
            quality,
            Quality::Fresh | Quality::Held | Quality::OpenLoop { .. }
        );
        let (lo_w, hi_w) = self.intervals[slot].around(power_w, open_steps);
        let (code, detail) = quality.encode();
        // A robot that runs open loop by the worker's clock is forecast further ahead.
        let ahead = 1 + u64::from(open_steps.saturating_sub(self.windows[slot].unread_steps));
        let mut flags = 0;
        flags |= if known {
            forecast_flag::POWER | forecast_flag::INTERVAL
        } else {
            0
        };
        flags |= if last.reading_w.is_nan() {
            0
        } else {
            forecast_flag::READING
        };
        flags |= if last.accepted {
            forecast_flag::SAMPLE
        } else {
            0
        };
        let watts = |value: f32| if known { value } else { f32::NAN };
        Forecast {
            robot: robot.id,
            flags,
            quality: code,
            quality_detail: detail,
            reading_w: last.reading_w,
            power_w: watts(power_w),
            lo_w: watts(lo_w),
            hi_w: watts(hi_w),
            generation: robot.generation,
            sample_seq: last.seq,
            stamp_ns: last.stamp_ns,
            target_ns: last.stamp_ns.saturating_add(ahead * platform.period_ns),
            reading_age_ns: last.stamp_ns.saturating_sub(last.measured_ns),
            source_epoch: robot.source_epoch,
        }
    }

    /// The diagnostics of the robot at `place`, as of the last tick.
    #[must_use]
    pub fn diagnostic(&self, place: usize) -> Diagnostic {
        let (slot, robot, _) = self.at(place);
        let (last, scores, detector) = (&robot.last, &self.scores[slot], &self.detectors[slot]);
        let kind = &self.kinds[usize::from(robot.platform)];
        let alarms = self.alarms(slot, robot);
        let (coverage, coverage_recent) = self.intervals[slot].coverage(scores.count);
        let mut flags = 0;
        flags |= if last.residual_w.is_nan() {
            0
        } else {
            diagnostic_flag::RESIDUAL
        };
        flags |= if scores.count == 0 {
            0
        } else {
            diagnostic_flag::SCORES
        };
        Diagnostic {
            robot: robot.id,
            flags,
            level: alarms.level().code(),
            alarm: alarms.first().code(),
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
            stamp_ns: last.stamp_ns,
            source_epoch: robot.source_epoch,
            refused: robot.refused,
        }
    }

    /// The budget of the robot at `place`, as of the last tick.
    #[must_use]
    pub fn budget(&self, place: usize) -> Budget {
        let (slot, robot, platform) = self.at(place);
        let (last, ledger) = (&robot.last, &self.ledgers[slot]);
        let charge_state = match (last.accepted, last.charging) {
            (false, _) => ChargeState::Unknown,
            (true, true) => ChargeState::Charging,
            (true, false) => ChargeState::Discharging,
        };
        let budget = Budget {
            robot: robot.id,
            flags: ledger.stamp_ns.map_or(0, |_| budget_flag::LEDGER)
                | if last.charged {
                    budget_flag::CHARGED
                } else {
                    0
                },
            charge_state: charge_state.code(),
            reserved: 0,
            drawn_uj: ledger.drawn_uj,
            drawn_remainder: ledger.drawn_remainder,
            forecast_uj: ledger.forecast_uj,
            metered_ns: ledger.metered_ns,
            unmetered_ns: ledger.unmetered_ns,
            stamp_ns: ledger.stamp_ns.unwrap_or(0),
            valid_until_ns: ledger
                .stamp_ns
                .map_or(0, |stamp| stamp.saturating_add(platform.stale_after_ns)),
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
            Some(battery) if !last.charged && last.accepted => {
                self.with_battery(budget, slot, robot, battery, platform)
            }
            _ => budget,
        }
    }

    fn with_battery(
        &self,
        mut budget: Budget,
        slot: usize,
        robot: &Robot,
        battery: &Battery,
        platform: &Platform,
    ) -> Budget {
        let capacity_j = battery.capacity_j;
        let drawn_j = budget.drawn_j();
        let silent_ns = self
            .now_ns
            .saturating_sub(robot.taken_ns)
            .saturating_sub(platform.period_ns);
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
        let (lo_w, hi_w) = self.intervals[slot].around(budget.mean_power_w, 0);
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

    /// Robots refused of late, with the reason and the source.
    #[must_use]
    pub fn refusals(&self) -> [Refusal; 16] {
        self.refused.places()
    }

    fn at(&self, place: usize) -> (usize, &Robot, &Platform) {
        let slot = self.live[place] as usize;
        let robot = &self.robots[slot];
        (
            slot,
            robot,
            &self.kinds[usize::from(robot.platform)].platform,
        )
    }

    fn is_stale(&self, robot: &Robot) -> bool {
        let platform = &self.kinds[usize::from(robot.platform)].platform;
        self.now_ns.saturating_sub(robot.taken_ns) > platform.stale_after_ns
    }

    fn quality(&self, robot: &Robot, power_w: f32, open_steps: u16) -> Quality {
        if self.is_stale(robot) {
            return Quality::Invalid(InvalidReason::Stale);
        }
        if let Some(reason) = robot.invalid {
            return Quality::Invalid(reason);
        }
        match robot.last.quality {
            quality @ (Quality::Warmup { .. } | Quality::Invalid(_) | Quality::Unknown) => quality,
            _ if !power_w.is_finite() => Quality::Invalid(InvalidReason::ModelOutput),
            _ if open_steps > 0 => Quality::OpenLoop { steps: open_steps },
            quality => quality,
        }
    }

    fn alarms(&self, slot: usize, robot: &Robot) -> AlarmSet {
        let raised = self.detectors[slot].raised();
        if self.is_stale(robot) {
            raised.with(Alarm::NoData)
        } else {
            raised
        }
    }
}
