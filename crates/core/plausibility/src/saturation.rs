//! Sensors at the end of their range, and registers that wrap.

use crate::column::{Column, LARGEST};

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
/// Dips before they count.
const MIN_WRAPS: usize = 3;
/// A wrap is larger than so many usual steps.
const WRAP_STEPS: f64 = 50.0;
/// And than this share of the usual reading.
const WRAP_SHARE: f64 = 0.5;
/// Relative difference of the mean wrap from 2^16 steps.
const WRAP_EXACT: f64 = 5e-3;

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
    ROUND.iter().any(|round| near_to(*round) || near_to(round * 10.0))
}

/// Readings at a full register: their number, and the value.
pub(crate) fn saturated(column: &Column) -> Option<(u64, f64)> {
    if !column.varies {
        return None;
    }
    let ends = [(column.at_greatest, column.greatest), (column.at_least, column.least)];
    let found = ends.into_iter().find(|(end, value)| {
        end.count >= MIN_AT_END && end.longest >= MIN_RUN && full(*value).is_some()
    });
    found.map(|(end, value)| (end.count, value))
}

/// Dips by 2^16 of a monitor's steps: how many were seen, and their size.
///
/// A load that is switched has equal steps as well, and a robot that brakes feeds energy back. So
/// the dips have to end below 0, and only they; or the values fill a signed register from end to
/// end.
pub(crate) fn wraps(column: &Column) -> Option<(u64, f64)> {
    if !(column.least < 0.0 && column.greatest > 0.0) {
        return None;
    }
    let dips = column.largest_dips.numbers();
    let steps = column.largest_steps.numbers();
    let only_dips = |(count, _): &(u64, f64)| {
        let all_kept = *count < LARGEST as u64;
        let most = if all_kept { count + count / 4 } else { column.count / 10 };
        column.negative <= most
    };
    wrap(column, dips).filter(only_dips).or_else(|| {
        let (steps, size) = wrap(column, steps)?;
        let ends = [column.greatest, -column.least];
        let fills = ends.iter().all(|end| (0.94..=1.0).contains(&(2.0 * end / size)));
        fills.then_some((steps.div_ceil(2), size))
    })
}

/// The steps that are far larger than all others, if they have the size of a register.
fn wrap(column: &Column, steps: &[f64]) -> Option<(u64, f64)> {
    let usual = column.steps.usual()?;
    let largest = steps.first()?.abs();
    let count = steps.partition_point(|step| step.abs() >= 0.5 * largest);
    let is_large = largest >= WRAP_STEPS * usual && largest >= WRAP_SHARE * column.sizes.usual()?;
    if count < MIN_WRAPS || !is_large {
        return None;
    }
    let wraps = &steps[..count];
    let mean = wraps.iter().map(|step| step.abs()).sum::<f64>() / count as f64;
    let is_alike = |step: &f64| (step.abs() - mean).abs() <= 8.0 * usual + 1e-3 * mean;
    (wraps.iter().all(is_alike) && is_round(mean / 65_536.0, WRAP_EXACT))
        .then_some((count as u64, mean))
}
