//! Whether recorded magnitudes fit the columns' units.

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
#[must_use]
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
    Some(PowerCheck {
        rows: ratios.len(),
        median_ratio: median(&mut ratios)?,
    })
}

/// Lower median.
pub(super) fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len().checked_sub(1)? / 2;
    Some(*values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Median of the magnitudes of a column's values that are recorded and not 0.
fn usual_size(trial: &Trial, column: Column) -> Option<f64> {
    let values = trial.column(column)?.iter().map(|value| value.abs());
    median(&mut values.filter(|value| *value > 0.0).collect::<Vec<_>>())
}

/// Columns that seem to be in another unit (or none, for the time), and why.
pub(super) fn suspicions(trial: &Trial) -> Vec<(Option<Column>, String)> {
    let mut found = Vec::new();
    let rate_hz = trial.notes().rate_hz;
    if !(0.05..=2_000.0).contains(&rate_hz) {
        let what = format!("{rate_hz:.4} rows a second: is the time in seconds?");
        found.push((None, what));
    }
    // A factor of ten may be an unusual robot; a factor of a thousand is a unit error.
    if let Some(check) = power_check(trial) {
        let thousands = (check.median_ratio.log10() / 3.0).round();
        if thousands != 0.0 && thousands.is_finite() {
            let ratio = check.median_ratio;
            let what = format!(
                "power is {ratio:.3e} times voltage times current: check that the columns are in mV, mA, mW"
            );
            found.push((Some(Column::Power), what));
        }
    }
    let sizes = [
        (Column::Voltage, 0.5, "V", "mV"),
        (Column::Power, 0.01, "W", "mW"),
    ];
    for (column, least, unit, wanted) in sizes {
        if let Some(size) = usual_size(trial, column).filter(|size| *size < least) {
            let what = format!("usually {size:.3e} {unit}: check that the column is in {wanted}");
            found.push((Some(column), what));
        }
    }
    found
}
