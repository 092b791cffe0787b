//! Numbers that mean that there is no reading.

use crate::battery::{COARSE, NEAR_A};
use crate::column::{Column, End};
use crate::quantity::UNMEASURED_A;

/// Readings before they count.
const MIN_COUNT: u64 = 3;
/// Other readings that show what is usual.
const MIN_OTHERS: u64 = 5;
/// Size of such a number in multiples of all others, and its distance from them.
const FAR: f64 = 5.0;
/// The same of one that comes once or twice among many.
const ALONE: f64 = 20.0;
const MANY: u64 = 50;
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
/// Units of a current in files, A.
const CURRENTS: [f64; 2] = [1.0, 1e-3];
/// Rounding of such a number, of 32 bits.
const EXACT: f64 = 1e-6;
/// Distance of the nearest other number if all are whole, in the unit of the file.
const WHOLE_APART: f64 = 10.0;
/// Readings of exactly that number for each of the nearest other one, of which a monitor with that
/// resolution has as many. A few are enough where the nearest is far.
const STANDS_OUT: u64 = 10;
const FAR_A: f64 = 0.3;
/// Units of files, in SI units.
const UNITS: [f64; 4] = [1.0, 1e-3, 1e-6, 1e-2];

/// A number far from all others that comes again and again.
pub(crate) struct Sentinel {
    pub(crate) count: u64,
    pub(crate) value: f64,
    /// The value as the file has it, as far as that is known.
    pub(crate) written: f64,
}

/// Each end of a column: how often it comes, the value, the next one, and the other end.
fn ends(column: &Column) -> [(End, f64, f64, f64); 2] {
    [
        (column.at_least, column.least, column.above_least, column.greatest),
        (column.at_greatest, column.greatest, column.below_greatest, column.least),
    ]
}

/// A number that came too seldom to be a sentinel, and is much greater than all others: how often,
/// and the number. The last one may be the first of others.
pub(crate) fn outlier(column: &Column) -> Option<(u64, f64)> {
    let is_alone = |(end, value, next, other): &(End, f64, f64, f64)| {
        let size = next.abs().max(other.abs());
        end.count < MIN_COUNT
            && column.count - end.count >= MANY
            && size > 0.0
            && value.abs() >= ALONE * size
            && column.last != *value
    };
    ends(column).into_iter().find(is_alone).map(|(end, value, ..)| (end.count, value))
}

pub(crate) fn sentinel(column: &Column) -> Option<Sentinel> {
    let found = ends(column).into_iter().find(|(end, value, next, other)| {
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

/// Readings of exactly 0 among others that are far from it: how many, and whether they are single
/// ones, of a monitor that did not answer.
pub(crate) fn silent(column: &Column) -> Option<(u64, bool)> {
    let usual = column.sizes.usual()?;
    let is_far = column.negative == 0 && column.above_least >= NEAR * usual;
    dropped(column).filter(|_| is_far)
}

/// Voltages of exactly 0 among others: how many, and whether they are single ones.
pub(crate) fn dropped(voltage: &Column) -> Option<(u64, bool)> {
    let end = voltage.at_least;
    let is_some =
        voltage.least == 0.0 && end.count >= MIN_COUNT && 10 * end.count < 9 * voltage.count;
    is_some.then_some((end.count, end.count as f64 <= MAX_RUN * end.runs as f64))
}

/// The readings of a current as they were recorded, among which drivers write [`UNMEASURED_A`] where
/// they measure none.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reserved([Amount; CURRENTS.len()]);

#[derive(Debug, Clone, Copy)]
struct Amount {
    exact: u64,
    others: u64,
    /// True if another is about as negative.
    has_near: bool,
    is_coarse: bool,
    is_whole: bool,
    /// The nearest others on both sides.
    beside: [Beside; 2],
}

/// A number beside the reserved one: how far it is away, and how often it comes.
#[derive(Debug, Clone, Copy)]
struct Beside {
    away: f64,
    count: u64,
}

impl Beside {
    fn take(&mut self, away: f64) {
        if away < self.away - EXACT {
            *self = Self { away, count: 0 };
        }
        self.count += u64::from(away <= self.away + EXACT);
    }
}

impl Reserved {
    pub(crate) const fn new() -> Self {
        let none = Amount {
            exact: 0,
            others: 0,
            has_near: false,
            is_coarse: true,
            is_whole: true,
            beside: [Beside { away: f64::INFINITY, count: 0 }; 2],
        };
        Self([none; CURRENTS.len()])
    }

    /// Takes a current with the sign that it has in its file, A.
    pub(crate) fn take(&mut self, recorded_a: f64) {
        if !recorded_a.is_finite() {
            return;
        }
        for (amount, unit) in self.0.iter_mut().zip(CURRENTS) {
            let value = recorded_a / unit;
            let away = (value - UNMEASURED_A).abs();
            if away <= EXACT {
                amount.exact += 1;
                continue;
            }
            let is_step = |steps: f64| (steps - steps.round()).abs() <= 1e-4;
            amount.others += u64::from(value != 0.0);
            amount.has_near |= NEAR_A.contains(&-value);
            amount.is_coarse &= is_step(COARSE * value);
            amount.is_whole &= is_step(value);
            amount.beside[usize::from(value > UNMEASURED_A)].take(away);
        }
    }

    /// Readings of exactly that number, and the number in A, if it stands out: a coarse monitor
    /// measures it now and then, and a fine one seldom.
    pub(crate) fn found(&self) -> Option<(u64, f64)> {
        let stands_out = |(amount, _): &(&Amount, f64)| {
            let nearest = amount.beside[0].away.min(amount.beside[1].away);
            let is_measured =
                (amount.is_coarse && amount.has_near) || (amount.is_whole && nearest < WHOLE_APART);
            let most = amount.beside.iter().map(|one| one.count).max().unwrap_or_default();
            let least = if nearest >= FAR_A { MIN_COUNT } else { STANDS_OUT * most };
            let stands_out = amount.exact >= least;
            amount.others >= MIN_OTHERS && stands_out && !is_measured
        };
        let (amount, unit) = self.0.iter().zip(CURRENTS).find(stands_out)?;
        Some((amount.exact, UNMEASURED_A * unit))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn minus_one_among_currents_is_none_where_it_stands_out() {
        let wave = |step: u32| 0.4 + 0.1 * f64::from(step).sin();
        type Others<'a> = &'a dyn Fn(u32) -> f64;
        let cases: [(&str, Others<'_>, f64, bool); 10] = [
            ("discharge is negative", &|step| -wave(step), 1.0, true),
            ("discharge is positive", &wave, 1.0, true),
            ("on both sides of it", &|step| -4.0 * wave(step), 1.0, true),
            ("mA", &|step| -1e3 * wave(step), 1e-3, true),
            ("whole mA", &|step| (-1e3 * wave(step)).round(), 1e-3, true),
            ("steps of 0.1 A", &|step| -1.0 - 0.1 * f64::from(step % 3), 1.0, false),
            ("whole amperes", &|step| -2.0 - f64::from(step % 3), 1.0, false),
            ("whole mA at rest", &|step| -2.0 * f64::from(step % 3), 1e-3, false),
            (
                "the other sign in steps of 0.1 A",
                &|step| 0.5 + 0.1 * f64::from(step % 6),
                1.0,
                true,
            ),
            ("nothing else", &|_| 0.0, 1.0, false),
        ];
        for (case, others, unit, expected) in cases {
            let mut reserved = Reserved::new();
            for step in 0..300 {
                reserved.take(unit * if step % 3 == 0 { -1.0 } else { others(step) });
            }
            let found = reserved.found().map(|(count, value)| (count >= 100, value));
            assert_eq!(found, expected.then_some((true, -unit)), "{case}");
        }
        let mut once = Reserved::new();
        (0..300).for_each(|step| once.take(if step == 7 { -1.0 } else { -1.0 - wave(step) }));
        assert_eq!(once.found(), None, "a fine monitor measures it once");
        let mut steps = Reserved::new();
        (0..600).for_each(|step| steps.take(-0.9 - 0.01 * f64::from(step % 20)));
        assert_eq!(steps.found(), None, "as often as the numbers beside it");
    }
}
