//! Energy left in the battery, and time to empty.

use joulebus_settings::Battery;

use crate::layout::lanes::{LANES, block};
use crate::ledger::battery::Estimate;

/// Energy left of a robot; NaN if unknown.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Remaining {
    /// Whether its battery is configured.
    pub battery: bool,
    pub left_j: f32,
    pub usable_j: f32,
    pub usable_lo_j: f32,
    pub soc: f32,
    pub soc_lo: f32,
    pub soc_hi: f32,
    pub soc_sd: f32,
    pub time_to_empty_s: f32,
    pub time_to_empty_lo_s: f32,
    pub time_to_empty_hi_s: f32,
}

impl Remaining {
    /// Computes it from the state of charge. `ends_w` is the interval around the mean power
    /// `mean_w`. `charging` states that nothing is drawn from the battery.
    #[inline(always)]
    pub(crate) fn of(
        battery: &Battery,
        estimate: &Estimate,
        mean_w: f32,
        ends_w: (f32, f32),
        charging: bool,
    ) -> Self {
        let capacity_j = battery.capacity_j;
        let mean_w = f64::from(mean_w).max(0.0);
        let (lo, hi) = (estimate.lo(), estimate.hi());
        let above = |share: f64| capacity_j * (share - battery.reserve).max(0.0);
        let (usable_j, usable_lo_j, usable_hi_j) = (above(estimate.soc), above(lo), above(hi));
        // Under persistent bias the interval may exclude the forecast; the bounds stay
        // conservative.
        let lo_w = f64::from(ends_w.0).min(mean_w);
        let hi_w = f64::from(ends_w.1).max(mean_w);
        let lasts_s = |joules: f64, watts: f64, positive: bool, otherwise: f32| {
            // Twice as many divisions a vector as in double precision, and nothing is subtracted.
            let seconds = joules as f32 / watts as f32;
            if positive { seconds } else { otherwise }
        };
        let draws = (mean_w > 0.0) & !charging;
        let longest_s = lasts_s(usable_hi_j, lo_w, lo_w > 0.0, f32::INFINITY);
        Self {
            battery: true,
            left_j: (capacity_j * estimate.soc) as f32,
            usable_j: usable_j as f32,
            usable_lo_j: usable_lo_j as f32,
            soc: estimate.soc as f32,
            soc_lo: lo as f32,
            soc_hi: hi as f32,
            soc_sd: estimate.sd as f32,
            time_to_empty_s: lasts_s(usable_j, mean_w, draws, f32::NAN),
            time_to_empty_lo_s: lasts_s(usable_lo_j, hi_w, draws, f32::NAN),
            time_to_empty_hi_s: if draws { longest_s } else { f32::NAN },
        }
    }
}

block! {
    /// Energy left of the robots of a block.
    #[derive(Debug, Clone, Copy)]
    pub(crate) struct RemainingLanes of Remaining {
        battery: bool,
        left_j: f32,
        usable_j: f32,
        usable_lo_j: f32,
        soc: f32,
        soc_lo: f32,
        soc_hi: f32,
        soc_sd: f32,
        time_to_empty_s: f32,
        time_to_empty_lo_s: f32,
        time_to_empty_hi_s: f32,
    }
}

impl RemainingLanes {
    pub(crate) const UNKNOWN: Self = Self {
        battery: [false; LANES],
        left_j: [f32::NAN; LANES],
        usable_j: [f32::NAN; LANES],
        usable_lo_j: [f32::NAN; LANES],
        soc: [f32::NAN; LANES],
        soc_lo: [f32::NAN; LANES],
        soc_hi: [f32::NAN; LANES],
        soc_sd: [f32::NAN; LANES],
        time_to_empty_s: [f32::NAN; LANES],
        time_to_empty_lo_s: [f32::NAN; LANES],
        time_to_empty_hi_s: [f32::NAN; LANES],
    };
}
