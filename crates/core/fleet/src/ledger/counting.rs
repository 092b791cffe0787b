//! How a platform's battery counts what its monitor reads.

use joulebus_energy::EnergyLeft;
use joulebus_settings::{Battery, ChargeReading, Platform};

/// In place of an unknown charging power, W: it fills every battery at once.
const ANY_W: f64 = 1e30;

/// A platform's settings for counting.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Counting {
    /// 1 / J.
    pub per_joule: f64,
    pub sd: f64,
    pub least_w: f64,
    pub most_w: f64,
    pub period_ns: u64,
    /// [`ChargeReading`] in flags: a `match` on it keeps a loop over lanes from becoming vectors.
    pub reads_load: bool,
    pub reads_charger: bool,
    pub efficiency: f64,
    pub charge_w: f64,
}

impl Counting {
    #[inline(always)]
    pub(crate) fn new(battery: &Battery, platform: &Platform) -> Self {
        Self {
            per_joule: 1.0 / battery.capacity_j,
            sd: battery.counting_sd,
            least_w: platform.power_min_w.into(),
            most_w: f64::from(platform.power_max_w).max(0.0),
            period_ns: platform.period_ns,
            reads_load: matches!(battery.charge_reading, ChargeReading::Load),
            reads_charger: matches!(battery.charge_reading, ChargeReading::Charger),
            efficiency: battery.charge_efficiency,
            charge_w: battery.charge_power_w.unwrap_or(ANY_W),
        }
    }

    /// That of a robot: with the [learned](learned) capacity of its battery, and the error of that
    /// in place of the stated one.
    #[inline(always)]
    pub(crate) fn of(&self, capacity: (f32, f32)) -> Self {
        let (share, sd) = learned(capacity).unwrap_or((1.0, self.sd));
        Self { per_joule: self.per_joule / share, sd, ..*self }
    }

    /// Change of the stored energy on the charger by an amount that the monitor counts. `None` if
    /// it does not meter the charge.
    #[inline(always)]
    pub(crate) fn stored(&self, amount: f64) -> Option<f64> {
        let stored = counted(self, amount, true);
        (!self.reads_load).then_some(stored)
    }
}

/// A learned capacity as a share of the stated one, and its relative standard deviation. `None`
/// before anything is learned, when that is 0.
#[inline(always)]
fn learned((share, sd): (f32, f32)) -> Option<(f64, f64)> {
    (sd > 0.0).then_some((share.into(), sd.into()))
}

/// The size of a robot's battery.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Size {
    pub capacity_j: f64,
    /// Relative standard deviation of a learned capacity. 0 of the stated one, whose error is that
    /// of counting.
    pub sd: f64,
    /// Of energy that is counted from a known charge on, as a share of it.
    pub counting_sd: f64,
}

impl Size {
    #[inline(always)]
    pub(crate) fn new(battery: &Battery, capacity: (f32, f32)) -> Self {
        let (share, sd) = learned(capacity).unwrap_or((1.0, 0.0));
        let counting_sd = if sd > 0.0 { sd } else { battery.counting_sd };
        Self { capacity_j: battery.capacity_j * share, sd, counting_sd }
    }

    /// What is left of the charge, with the error of the capacity in what is above `reserve`. If
    /// the capacity is less, a greater share of it has been drawn, and the rest is less energy.
    #[inline(always)]
    pub(crate) fn left(&self, now: &EnergyLeft, reserve: f64) -> EnergyLeft {
        EnergyLeft { monitor: now.monitor - self.sd * (now.left - reserve).max(0.0), ..*now }
    }

    /// Relative error of counting energy that is yet to be drawn. The same monitor has taught the
    /// capacity, so its error is that of the energy left.
    #[inline(always)]
    pub(crate) fn ahead_sd(&self) -> f64 {
        if self.sd > 0.0 { 0.0 } else { self.counting_sd }
    }
}

/// Change of the state of charge by a drawn share, negative if the power flowed the other way.
#[inline(always)]
pub(crate) fn counted(counting: &Counting, drawn: f64, charging: bool) -> f64 {
    let stored = if counting.reads_charger { drawn } else { -drawn };
    let part = if stored > 0.0 { counting.efficiency } else { 1.0 };
    if charging { part * stored } else { -drawn }
}
