//! Sensors at the end of their range, and registers that wrap.

use std::ops::RangeInclusive;

use crate::column::{Column, End, LARGEST};

/// Readings at the end of the range before it counts.
const MIN_AT_END: u64 = 5;
/// Consecutive ones among them.
const MIN_RUN: u64 = 3;
/// Equal readings at any end of the range before they count, and consecutive ones among them.
const MIN_PILE: u64 = 20;
const MIN_PILE_RUN: u64 = 5;
/// Runs of them: a charger holds its voltage, and its current, once.
const MIN_PILE_RUNS: u64 = 3;
/// Share of the readings at the end that equal the one before, and of all others.
const STAYS: f64 = 0.3;
const STAYS_ELSEWHERE: f64 = 0.02;
/// Relative difference from a full register that rounding leaves.
const EXACT: f64 = 2e-6;
/// Full registers: signed and unsigned, of 16 bits.
const FULL: [f64; 2] = [32_767.0, 65_535.0];
/// Steps of usual monitors, as mantissas.
const ROUND: [f64; 7] = [1.0, 1.25, 2.0, 2.5, 4.0, 5.0, 8.0];
/// Bits of registers that wrap.
const BITS: RangeInclusive<i32> = 12..=24;
/// Share of a register that its values leave at either end.
const LEFT_AT_ENDS: f64 = 5e-3;
/// Share of a register that a wrap passes.
const PASSED: f64 = 0.9;
/// Dips before they count.
const MIN_WRAPS: usize = 3;
/// A wrap is larger than so many usual steps.
const WRAP_STEPS: f64 = 50.0;
/// And than this share of the usual reading.
const WRAP_SHARE: f64 = 0.5;
/// Relative difference of the mean wrap from a register.
const WRAP_EXACT: f64 = 5e-3;
/// Values below 0 that a register shows as its end: how many times, how long in the mean, and the
/// share of the register within which they are.
const MIN_SPIKES: u64 = 5;
const MAX_SPIKE_RUN: u64 = 3;
const SPIKE_EXACT: f64 = 5e-3;

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

/// True if the mantissa is that of a usual step.
fn is_round(step: f64, near: f64) -> bool {
    if !(step > 0.0 && step.is_finite()) {
        return false;
    }
    let mantissa = step / 10f64.powf(step.log10().floor());
    let near_to = |round: f64| (mantissa / round - 1.0).abs() <= near;
    ROUND.iter().any(|round| near_to(*round) || near_to(round * 10.0))
}

/// Readings at the end of a monitor's range: their number, the value, and whether it is a full
/// register.
pub(crate) fn saturated(column: &Column) -> Option<(u64, f64, bool)> {
    if !column.varies {
        return None;
    }
    let ends = [(column.at_greatest, column.greatest), (column.at_least, column.least)];
    let full = ends.into_iter().find(|(end, value)| {
        end.count >= MIN_AT_END && end.longest >= MIN_RUN && full(*value).is_some()
    });
    let found = full.map(|(end, value)| (end.count, value, true));
    found.or_else(|| {
        // A robot at rest may draw nothing but the least.
        let found = ends.into_iter().find(|(end, value)| {
            *value > 0.0 && *value == column.greatest && is_pile(column, *end)
        });
        found.map(|(end, value)| (end.count, value, false))
    })
}

/// True if values stay at an end as they stay nowhere else: those of a coarse or a slow monitor
/// repeat everywhere.
fn is_pile(column: &Column, end: End) -> bool {
    let others = column.count - end.count;
    let stays = (end.count - end.runs) as f64 / end.count.max(1) as f64;
    let repeats = (column.repeats + end.runs).saturating_sub(end.count);
    let elsewhere = repeats as f64 / others.max(1) as f64;
    end.count >= MIN_PILE
        && end.runs >= MIN_PILE_RUNS
        && end.longest >= MIN_PILE_RUN
        && others >= MIN_PILE
        && stays >= STAYS
        && elsewhere <= STAYS_ELSEWHERE
}

/// Wraps by the register of a monitor: how many were seen, and their size.
///
/// A load that is switched has equal steps as well, and a robot that brakes feeds energy back. So
/// the dips have to end below 0, and only they, or the values fill a signed register from end to
/// end.
pub(crate) fn wraps(column: &Column) -> Option<(u64, f64)> {
    if let Some(found) = filled(column) {
        return Some(found);
    }
    if let Some(found) = unsigned(column) {
        return Some(found);
    }
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
    let is_register =
        BITS.into_iter().any(|bits| is_round(mean / f64::from(bits).exp2(), WRAP_EXACT));
    (wraps.iter().all(is_alike) && is_register).then_some((count as u64, mean))
}

/// Values around 0 of which those below 0 are read as the end of an unsigned register.
fn unsigned(column: &Column) -> Option<(u64, f64)> {
    let spikes = &column.spikes;
    let is_end = spikes.greatest - spikes.least <= SPIKE_EXACT * spikes.greatest
        && 10 * spikes.from_zero >= 9 * spikes.count;
    (spikes.count >= MIN_SPIKES
        && spikes.readings <= MAX_SPIKE_RUN * spikes.count
        && 4 * spikes.readings <= column.count
        && column.negative == 0
        && spikes.least < spikes.greatest
        && is_end)
        .then_some((spikes.count, spikes.greatest))
}

/// Steps across a register that the values fill from end to end, signed or unsigned, however often
/// it wraps.
fn filled(column: &Column) -> Option<(u64, f64)> {
    let span = column.greatest - column.least;
    if column.decimals >= Column::CONTINUUM || !(span > 0.0 && span.is_finite()) {
        return None;
    }
    let size = BITS.rev().find_map(|bits| {
        let counts = f64::from(bits).exp2();
        let step = round_above(span / counts)?;
        let size = step * counts;
        let least = if column.least < 0.0 { -0.5 * size } else { 0.0 };
        let left = [column.least - least, least + size - column.greatest];
        let near = -1e-9 * size..=LEFT_AT_ENDS * size;
        // The values are whole steps.
        let per_step = step * 10f64.powi(column.decimals.into());
        let is_grid = per_step > 0.99 && (per_step - per_step.round()).abs() < 1e-3;
        (is_grid && left.iter().all(|left| near.contains(left))).then_some(size)
    })?;
    let steps = column.largest_steps.numbers();
    let wraps = steps.iter().filter(|step| step.abs() >= PASSED * size).count();
    (wraps >= MIN_WRAPS).then_some((wraps as u64, size))
}

/// The usual step that is larger by so little that a register of it may have this range.
fn round_above(step: f64) -> Option<f64> {
    let decade = 10f64.powf(step.log10().floor());
    let mut rounds = ROUND.iter().map(|round| round * decade).chain([10.0 * decade]);
    rounds.find(|round| *round >= step && step >= round * (1.0 - 2.0 * LEFT_AT_ENDS))
}
