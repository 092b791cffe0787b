//! Judges whether recorded magnitudes fit the columns' units.

use serde::Serialize;

use crate::trial::{Column, Trial};

/// Power compared with voltage times current.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PowerCheck {
    /// Rows with all three and a non-zero product.
    pub rows: usize,
    /// Median of |power| / |voltage · current|: 1 if all three are in the right units.
    pub median_ratio: f64,
}

/// Compares power with voltage times current. `None` if no row has all three.
pub fn power_check(trial: &Trial) -> Option<PowerCheck> {
    let columns = [Column::Power, Column::Voltage, Column::Current].map(|c| trial.column(c));
    let [Some(power_w), Some(voltage_v), Some(current_a)] = columns else {
        return None;
    };
    let mut ratios: Vec<f64> = power_w
        .iter()
        .zip(voltage_v.iter().zip(current_a))
        .map(|(power_w, (voltage_v, current_a))| (power_w / (voltage_v * current_a)).abs())
        .filter(|ratio| ratio.is_finite())
        .collect();
    Some(PowerCheck { rows: ratios.len(), median_ratio: median(&mut ratios)? })
}

/// Lower median.
pub(super) fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len().checked_sub(1)? / 2;
    Some(*values.select_nth_unstable_by(middle, f64::total_cmp).1)
}
