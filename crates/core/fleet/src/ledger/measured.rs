//! The battery's values in a sample: a measured state of charge, and how it continues the previous
//! samples.

use joulebus_settings::Battery;

/// Steps that the variance of a rounded value stands for: while the charge crosses one step, some
/// hundred values in a row are rounded alike.
const ROUNDING: f64 = 10.0;

/// A measured state of charge with its errors.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Measured {
    pub soc: f64,
    /// Standard deviation of the error that lasts.
    pub sd: f64,
    pub step: f64,
}

impl Measured {
    pub(crate) fn new(soc: f64, battery: &Battery, by_voltage: bool) -> Self {
        let table = battery.open_circuit.filter(|_| by_voltage);
        Self {
            soc,
            sd: table.map_or(battery.sensor_sd, |table| table.sd),
            step: battery.sensor_step,
        }
    }

    /// Variance of the error that does not last.
    pub(crate) fn noise(&self) -> f64 {
        ROUNDING * self.step * self.step + 1e-6
    }
}

/// A sample's information about the time before it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BatterySample {
    pub stamp_ns: u64,
    /// Power, W. NaN without a reading.
    pub reading_w: f32,
    pub charging: bool,
    /// True if it does not continue the samples before.
    pub broken: bool,
}
