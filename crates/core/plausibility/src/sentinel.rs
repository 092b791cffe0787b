//! Numbers that mean that there is no reading.

use crate::column::Column;

/// Readings before they count.
const MIN_COUNT: u64 = 3;
/// Other readings that show what is usual.
const MIN_OTHERS: u64 = 5;
/// Size of such a number in multiples of all others, and its distance from them.
const FAR: f64 = 5.0;
/// The same of a number that is used for it.
const NAMED_SIZE: f64 = 1.5;
/// Consecutive readings of one that is not: a state of the robot lasts longer.
const MAX_RUN: f64 = 3.0;
/// Share of the usual reading that a robot, or a coarse monitor, has beside 0.
const NEAR: f64 = 0.2;
/// Numbers that are used for it, in the unit of the file.
const NAMED: [f64; 9] = [
    255.0,
    999.0,
    9_999.0,
    99_999.0,
    32_767.0,
    32_768.0,
    65_535.0,
    2_147_483_647.0,
    4_294_967_295.0,
];
/// Share by which 32 bits of a capture may be beside it.
const SAME: f64 = 2e-7;
/// Units of files, in SI units.
const UNITS: [f64; 4] = [1.0, 1e-3, 1e-6, 1e-2];

/// A number far from all others that comes again and again.
pub(crate) struct Sentinel {
    /// Its readings.
    pub(crate) count: u64,
    /// In SI units.
    pub(crate) value: f64,
    /// The value as the file has it, as far as that is known.
    pub(crate) written: f64,
}

/// The sentinel of a column.
pub(crate) fn sentinel(column: &Column) -> Option<Sentinel> {
    let ends = [
        (column.at_least, column.least, column.above_least, column.greatest),
        (column.at_greatest, column.greatest, column.below_greatest, column.least),
    ];
    let found = ends.into_iter().find(|(end, value, next, other)| {
        let (gap, span) = ((next - value).abs(), (other - next).abs());
        let size = next.abs().max(other.abs());
        let is_far = value.abs() >= FAR * size
            && gap >= FAR * span
            && end.count as f64 <= MAX_RUN * end.runs as f64;
        let is_named =
            value.abs() >= NAMED_SIZE * size && gap >= span && written(*value, &NAMED).is_some();
        // Where nothing else is negative, and not because the monitor is coarse.
        let is_minus_one =
            written(*value, &[1.0]).is_some() && (column.decimals > 0 || gap >= 10.0);
        let is_negative = *value < 0.0
            && *next > 0.0
            && gap >= 0.3 * span
            && (written(*value, &NAMED).is_some() || is_minus_one);
        let others = column.count - end.count;
        end.count >= MIN_COUNT
            && others >= MIN_OTHERS
            && span > 0.0
            && span.is_finite()
            && (is_far || is_named || is_negative)
    });
    found.map(|(end, value, ..)| {
        let named = written(value, &NAMED).or_else(|| written(value, &[1.0]));
        Sentinel { count: end.count, value, written: named.unwrap_or(value) }
    })
}

/// The number in the unit of a file, if it is one of these.
fn written(value: f64, numbers: &[f64]) -> Option<f64> {
    let pairs = UNITS.iter().flat_map(|unit| numbers.iter().map(move |number| (unit, number)));
    let mut found =
        pairs.filter(|(unit, number)| (value.abs() / (*number * *unit) - 1.0).abs() < SAME);
    found.next().map(|(_, number)| number.copysign(value))
}

/// Single readings of exactly 0 among others that are far from it: a monitor that did not answer.
/// How many.
pub(crate) fn silent(column: &Column) -> Option<u64> {
    let usual = column.sizes.usual()?;
    let is_far = column.negative == 0 && column.above_least >= NEAR * usual;
    dropped(column).filter(|(_, single)| *single && is_far).map(|(count, _)| count)
}

/// Voltages of exactly 0 among others: how many, and whether they are single ones.
pub(crate) fn dropped(voltage: &Column) -> Option<(u64, bool)> {
    let end = voltage.at_least;
    let is_some =
        voltage.least == 0.0 && end.count >= MIN_COUNT && 10 * end.count < 9 * voltage.count;
    is_some.then_some((end.count, end.count as f64 <= MAX_RUN * end.runs as f64))
}
