//! Energy left in the battery, and time to empty.

use joulebus_energy::EnergyLeft;
use joulebus_predictor::nan::canonical;
use joulebus_settings::Battery;

use crate::layout::lanes::block;
use crate::ledger::counting::Size;

block! {
    /// Energy left of a robot. NaN if unknown.
    #[derive(Debug, Clone, Copy)]
    pub(crate) struct Remaining: UNKNOWN;

    /// Energy left of the robots of a block.
    #[derive(Debug, Clone, Copy)]
    pub(crate) struct RemainingLanes {
        /// True if its battery is configured.
        pub battery: bool = false,
        pub left_j: f32 = f32::NAN,
        pub usable_j: f32 = f32::NAN,
        pub usable_lo_j: f32 = f32::NAN,
        pub soc: f32 = f32::NAN,
        pub soc_lo: f32 = f32::NAN,
        pub soc_hi: f32 = f32::NAN,
        pub soc_sd: f32 = f32::NAN,
        pub time_to_empty_s: f32 = f32::NAN,
        pub time_to_empty_lo_s: f32 = f32::NAN,
        pub time_to_empty_hi_s: f32 = f32::NAN,
    }
}

block! {
    /// [`EnergyLeft`] of a robot.
    #[derive(Debug, Clone, Copy)]
    pub(crate) struct Left: UNKNOWN;

    /// The same of the robots of a block.
    #[derive(Debug, Clone, Copy)]
    pub(crate) struct LeftLanes {
        left: f64 = f64::NAN,
        own_sd: f64 = f64::NAN,
        monitor: f64 = f64::NAN,
        below: f64 = f64::NAN,
        above: f64 = f64::NAN,
        range_sd: f64 = f64::NAN,
    }
}

impl LeftLanes {
    pub(crate) const UNKNOWN: Self = Self::all(&Left::UNKNOWN);
}

impl From<EnergyLeft> for Left {
    #[inline(always)]
    fn from(EnergyLeft { left, own_sd, monitor, below, above, range_sd }: EnergyLeft) -> Self {
        Self { left, own_sd, monitor, below, above, range_sd }
    }
}

impl From<Left> for EnergyLeft {
    #[inline(always)]
    fn from(Left { left, own_sd, monitor, below, above, range_sd }: Left) -> Self {
        Self { left, own_sd, monitor, below, above, range_sd }
    }
}

impl Remaining {
    /// Computes it from the state of charge and the mean power `mean_w`. `range_w`: its 90 %
    /// interval over a duration. `charging` states that nothing is drawn from the battery.
    ///
    /// The bounds of the time allow for both: the square of their distance from the estimate is the
    /// sum of the squares by the energy alone and by the power alone.
    #[inline(always)]
    pub(crate) fn new(
        (battery, size): (&Battery, &Size),
        now: &EnergyLeft,
        mean_w: f32,
        range_w: impl Fn(f32) -> [f32; 2],
        charging: bool,
    ) -> Self {
        let capacity_j = size.capacity_j;
        let mean_w = f64::from(mean_w).max(0.0);
        let (lo, hi) = (now.lo().max(0.0), now.hi().min(1.0));
        let above = |share: f64| capacity_j * (share - battery.reserve).max(0.0);
        let energy = size.left(now, battery.reserve);
        let [energy_lo, energy_hi] = [energy.lo().max(0.0), energy.hi().min(1.0)];
        let usable_j = above(now.left);
        let (usable_lo_j, usable_hi_j) = (above(energy_lo), above(energy_hi));
        let draws = (mean_w > 0.0) & !charging;
        // Twice as many divisions a vector as in double precision.
        let [less, more] = EnergyLeft::counting_factors(size.ahead_sd());
        let middle_j = usable_j as f32;
        let (lo_j, hi_j) = ((less * usable_lo_j) as f32, (more * usable_hi_j) as f32);
        let mean_w = mean_w as f32;
        let seconds = middle_j / mean_w;
        // Under persistent bias the interval may exclude the forecast. The bounds stay
        // conservative.
        let [lo_w, hi_w] = range_w(seconds);
        let (lo_w, hi_w) = (lo_w.min(mean_w), hi_w.max(mean_w));
        let both = |one: f32, other: f32| 1.0 + (one * one + other * other).sqrt();
        // An empty battery has no relative bounds.
        let empty = middle_j <= 0.0;
        let shorter = both((middle_j - lo_j) / lo_j, (hi_w - mean_w) / mean_w);
        let longer = both((hi_j - middle_j) / middle_j, (mean_w - lo_w) / lo_w);
        let shortest_s = if (lo_j > 0.0) & !empty { seconds / shorter } else { 0.0 };
        let longest_s = if empty { hi_j / lo_w } else { seconds * longer };
        let longest_s = if (lo_w > 0.0) | (hi_j <= 0.0) { longest_s } else { f32::INFINITY };
        let longest_s = if hi_j > 0.0 { longest_s } else { 0.0 };
        // Between empty and full lies every battery.
        let charge = (lo > 0.0) | (hi < 1.0);
        let known = |value: f32| if charge { canonical(value) } else { f32::NAN };
        let lasting = |seconds: f32| if draws & charge { canonical(seconds) } else { f32::NAN };
        Self {
            battery: true,
            left_j: known((capacity_j * now.left) as f32),
            usable_j: known(middle_j),
            usable_lo_j: known(usable_lo_j as f32),
            soc: known(now.left as f32),
            soc_lo: known(lo as f32),
            soc_hi: known(hi as f32),
            soc_sd: known(now.whole_sd().min(1.0) as f32),
            time_to_empty_s: lasting(seconds),
            time_to_empty_lo_s: lasting(shortest_s),
            time_to_empty_hi_s: lasting(longest_s),
        }
    }
}

impl RemainingLanes {
    pub(crate) const UNKNOWN: Self = Self::all(&Remaining::UNKNOWN);
}
