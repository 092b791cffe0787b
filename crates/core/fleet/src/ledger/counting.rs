//! How a platform's battery counts what its monitor reads.

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
    pub reading: ChargeReading,
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
            reading: battery.charge_reading,
            efficiency: battery.charge_efficiency,
            charge_w: battery.charge_power_w.unwrap_or(ANY_W),
        }
    }

    /// Change of the stored energy on the charger by an amount that the monitor counts. `None` if
    /// it does not meter the charge.
    #[inline(always)]
    pub(crate) fn stored(&self, amount: f64) -> Option<f64> {
        let is_metered = !matches!(self.reading, ChargeReading::Load);
        is_metered.then(|| counted(self, amount, true))
    }
}

/// Change of the state of charge by a drawn share, negative if the power flowed the other way.
#[inline(always)]
pub(crate) fn counted(counting: &Counting, drawn: f64, charging: bool) -> f64 {
    let stored = match counting.reading {
        ChargeReading::Battery | ChargeReading::Load => -drawn,
        ChargeReading::Charger => drawn,
    };
    let part = if stored > 0.0 { counting.efficiency } else { 1.0 };
    if charging { part * stored } else { -drawn }
}
