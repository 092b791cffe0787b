//! Energy left in the battery, and time to empty.

use joulebus_settings::Battery;

use crate::layout::lanes::{LANES, block};

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
    pub time_to_empty_s: f32,
    pub time_to_empty_lo_s: f32,
    pub time_to_empty_hi_s: f32,
}

impl Remaining {
    /// From the energy drawn since the battery's initial state: `drawn_uj`, plus in `unmetered_ns`
    /// an unknown energy, at most `most_w` times that. `ends_w`: the interval around the mean power
    /// `mean_w`.
    #[inline(always)]
    pub(crate) fn of(
        battery: &Battery,
        most_w: f32,
        (drawn_uj, unmetered_ns): (i64, u64),
        mean_w: f32,
        ends_w: (f32, f32),
    ) -> Self {
        let capacity_j = battery.capacity_j;
        let drawn_j = drawn_uj as f64 * 1e-6;
        let unmetered_s = unmetered_ns as f64 * 1e-9;
        let mean_w = f64::from(mean_w).max(0.0);
        let left_j = capacity_j * battery.initial_soc - drawn_j - unmetered_s * mean_w;
        // The conservative bound assumes maximum power in unmetered time.
        let worst_w = f64::from(most_w).max(0.0);
        let left_lo_j = capacity_j * battery.initial_soc_lo - drawn_j - unmetered_s * worst_w;
        // Regeneration cannot fill a battery beyond full.
        let (left_j, left_lo_j) = (left_j.min(capacity_j), left_lo_j.min(capacity_j));
        let reserve_j = capacity_j * battery.reserve;
        // The same for all robots of the platform.
        let per_capacity = 1.0 / capacity_j;
        let soc = |joules: f64| (joules * per_capacity).clamp(0.0, 1.0) as f32;
        let usable_j = (left_j - reserve_j).max(0.0);
        let usable_lo_j = (left_lo_j - reserve_j).max(0.0);
        // Under persistent bias the interval may exclude the forecast; the bounds stay conservative.
        let lo_w = f64::from(ends_w.0).min(mean_w);
        let hi_w = f64::from(ends_w.1).max(mean_w);
        let lasts_s = |joules: f64, watts: f64, positive: bool, otherwise: f32| {
            // Twice as many divisions a vector as in double precision, and nothing is subtracted.
            let seconds = joules as f32 / watts as f32;
            if positive { seconds } else { otherwise }
        };
        let draws = mean_w > 0.0;
        let longest_s = lasts_s(usable_j, lo_w, lo_w > 0.0, f32::INFINITY);
        Self {
            battery: true,
            left_j: left_j.max(0.0) as f32,
            usable_j: usable_j as f32,
            usable_lo_j: usable_lo_j as f32,
            soc: soc(left_j),
            soc_lo: soc(left_lo_j),
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
        time_to_empty_s: [f32::NAN; LANES],
        time_to_empty_lo_s: [f32::NAN; LANES],
        time_to_empty_hi_s: [f32::NAN; LANES],
    };
}
