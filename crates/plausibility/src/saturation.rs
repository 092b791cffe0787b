//! Sensors at the end of their range, and registers that wrap.

use crate::column::Column;

/// Readings at the end of the range before it counts.
const MIN_AT_END: u64 = 5;
/// Consecutive ones among them.
const MIN_RUN: u64 = 3;
/// Relative difference from a full register that rounding leaves.
const EXACT: f64 = 2e-6;
/// Full registers: signed and unsigned, of 16 bits.
const FULL: [f64; 2] = [32_767.0, 65_535.0];
/// Steps of usual monitors, as mantissas.
const ROUND: [f64; 7] = [1.0, 1.25, 2.0, 2.5, 4.0, 5.0, 8.0];
/// Steps of a register's size before it counts: two dips.
const MIN_WRAPS: usize = 4;
/// A wrap is larger than so many usual steps.
const WRAP_STEPS: f64 = 50.0;
/// Relative difference of the mean wrap from 2^16 steps.
const WRAP_EXACT: f64 = 5e-3;
/// Share of readings in dips; more is a load that is switched.
const MAX_DIPPED: f64 = 0.1;

/// The size of a monitor's step if `end` is a full register of it.
fn full(end: f64) -> Option<f64> {
    let size = end.abs();
    let mut registers = FULL.to_vec();
    if end < 0.0 {
        registers.push(32_768.0);
    }
    let by_step = registers.into_iter().find_map(|register| {
        let step = size / register;
        is_round(step, EXACT).then_some(step)
    });
    // The step may be a round range divided by 2^15.
    by_step.or_else(|| {
        let step = size / 32_767.0;
        is_round(step * 32_768.0, EXACT).then_some(step)
    })
}

/// Whether the mantissa is that of a usual step.
fn is_round(step: f64, near: f64) -> bool {
    if !(step > 0.0 && step.is_finite()) {
        return false;
    }
    let mantissa = step / 10f64.powf(step.log10().floor());
    let near_to = |round: f64| (mantissa / round - 1.0).abs() <= near;
    ROUND
        .iter()
        .any(|round| near_to(*round) || near_to(round * 10.0))
}

/// Readings at a full register: their number, and the value.
pub(crate) fn saturated(column: &Column) -> Option<(u64, f64)> {
    if !column.varies {
        return None;
    }
    let ends = [
        (column.at_greatest, column.greatest),
        (column.at_least, column.least),
    ];
    let found = ends.into_iter().find(|(end, value)| {
        end.count >= MIN_AT_END && end.longest >= MIN_RUN && full(*value).is_some()
    });
    found.map(|(end, value)| (end.count, value))
}

/// Steps by 2^16 of a monitor's steps: their number, and their size.
pub(crate) fn wraps(column: &Column) -> Option<(u64, f64)> {
    let usual = column.steps.usual()?;
    let steps = column.largest_steps();
    let large: Vec<f64> = steps
        .iter()
        .map(|step| step.abs())
        .filter(|size| *size > WRAP_STEPS * usual)
        .collect();
    // The largest steps all fit: more of them are the rule, not dips.
    if large.len() < MIN_WRAPS
        || large.len() == steps.len() && steps.len() as u64 * 10 > column.count
    {
        return None;
    }
    let mean = large.iter().sum::<f64>() / large.len() as f64;
    let alike = large
        .iter()
        .all(|size| (size - mean).abs() <= 6.0 * usual + 1e-3 * mean);
    let dips = steps
        .iter()
        .filter(|step| step.abs() > WRAP_STEPS * usual && **step < 0.0);
    let is_rare = large.len() as f64 <= 2.0 * MAX_DIPPED * column.count as f64;
    let falls = dips.count();
    let is_paired = falls.abs_diff(large.len() - falls) <= 1;
    (alike && is_rare && is_paired && is_round(mean / 65_536.0, WRAP_EXACT))
        .then_some((falls.max(1) as u64, mean))
}
