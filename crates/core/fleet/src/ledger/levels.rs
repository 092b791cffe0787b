//! Levels of a battery: low, critical, and too little to return.

use joulebus_energy::EnergyLeft;
use joulebus_settings::Battery;
use joulebus_wire::{Alarm, AlarmSet};

use crate::ledger::counting::Size;

const fn bit(alarm: Alarm) -> u32 {
    AlarmSet(0).with(alarm).0
}

/// A battery is worn if its learned capacity, at the upper end of the interval, is below this share
/// of the stated one. There makers and standards end its life.
const WORN: f64 = 0.8;

/// The battery's alarms after those `raised` before, with what is left `now`: raised below a threshold,
/// cleared a band above it. `return_j`: energy to return that the sample states, NaN if none.
#[inline(always)]
pub(crate) fn judge(
    raised: u32,
    (battery, size): (&Battery, &Size),
    now: &EnergyLeft,
    return_j: f64,
) -> u32 {
    let band = battery.level_band;
    let configured_j = battery.return_j.unwrap_or(f64::NAN);
    let needed_j = if return_j.is_nan() { configured_j } else { return_j };
    let needed = needed_j / size.capacity_j;
    // What is certainly left for the return: the monitor will count that with its error.
    let back = now.after_drawing(needed, size.counting_sd);
    let certain = (back.lo() + needed).max(0.0);
    let below = |alarm: Alarm, share: f64, threshold: f64| {
        let stays = (raised & bit(alarm) != 0) & (share < threshold + band);
        if (share < threshold) | stays { bit(alarm) } else { 0 }
    };
    let most_j = size.capacity_j * (1.0 + EnergyLeft::SIGMAS * size.sd);
    let worn = (size.sd > 0.0) & (most_j < WORN * battery.capacity_j);
    (raised & bit(Alarm::SocImplausible))
        | if worn { bit(Alarm::BatteryWorn) } else { 0 }
        | below(Alarm::BatteryLow, now.left, battery.low)
        | below(Alarm::BatteryCritical, now.left, battery.critical)
        // Without a stated need nothing is below it.
        | below(Alarm::CannotReturn, certain, needed)
}
