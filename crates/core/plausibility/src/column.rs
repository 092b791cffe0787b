//! Statistics of one quantity in bounded memory.

use crate::sizes::Sizes;

/// Largest steps between consecutive values that are kept.
pub(crate) const LARGEST: usize = 24;
/// Share of a step by which the way back may differ.
const BACK: f64 = 0.25;

/// The numbers of greatest size, with their signs, in descending size.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Largest([f64; LARGEST]);

impl Largest {
    const NONE: Self = Self([0.0; LARGEST]);

    fn add(&mut self, number: f64) {
        let kept = &mut self.0;
        let size = number.abs();
        if size.is_nan() || size <= kept[LARGEST - 1].abs() {
            return;
        }
        let place = kept.partition_point(|larger| larger.abs() >= size);
        kept.copy_within(place..LARGEST - 1, place + 1);
        kept[place] = number;
    }

    /// All of them.
    pub(crate) fn numbers(&self) -> &[f64] {
        &self.0[..self.0.partition_point(|number| *number != 0.0)]
    }
}

/// Values of one quantity of one robot.
#[derive(Debug, Clone)]
pub(crate) struct Column {
    pub(crate) count: u64,
    pub(crate) zero: u64,
    pub(crate) negative: u64,
    /// Values outside the range that is known for it.
    pub(crate) outside: u64,
    pub(crate) least: f64,
    pub(crate) greatest: f64,
    pub(crate) first: f64,
    pub(crate) last: f64,
    pub(crate) varies: bool,
    pub(crate) sizes: Sizes,
    pub(crate) steps: Sizes,
    pub(crate) at_greatest: End,
    pub(crate) at_least: End,
    /// The largest steps.
    pub(crate) largest_steps: Largest,
    /// The largest steps down of those that come back with the next value.
    pub(crate) largest_dips: Largest,
    /// The step before.
    step: f64,
}

/// Values equal to an end of the range.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct End {
    /// Values at the end.
    pub(crate) count: u64,
    /// Values at the end since the last one that was not.
    run: u64,
    /// The longest run.
    pub(crate) longest: u64,
}

impl End {
    fn take(&mut self, is_at_end: bool) {
        self.run = if is_at_end { self.run + 1 } else { 0 };
        self.count += u64::from(is_at_end);
        self.longest = self.longest.max(self.run);
    }
}

impl Column {
    pub(crate) const fn new() -> Self {
        Self {
            count: 0,
            zero: 0,
            negative: 0,
            outside: 0,
            least: f64::INFINITY,
            greatest: f64::NEG_INFINITY,
            first: f64::NAN,
            last: f64::NAN,
            varies: false,
            sizes: Sizes::new(),
            steps: Sizes::new(),
            at_greatest: End { count: 0, run: 0, longest: 0 },
            at_least: End { count: 0, run: 0, longest: 0 },
            largest_steps: Largest::NONE,
            largest_dips: Largest::NONE,
            step: 0.0,
        }
    }

    /// Takes a value; NaN and infinities are none.
    pub(crate) fn take(&mut self, value: f64, range: Option<(f64, f64)>) {
        if !value.is_finite() {
            return;
        }
        if self.count == 0 {
            self.first = value;
        } else {
            self.varies |= value != self.first;
            self.step(value - self.last);
        }
        self.count += 1;
        self.zero += u64::from(value == 0.0);
        self.negative += u64::from(value < 0.0);
        let is_outside =
            range.is_some_and(|(least, greatest)| !(least <= value && value <= greatest));
        self.outside += u64::from(is_outside);
        self.sizes.add(value);
        if value > self.greatest {
            self.greatest = value;
            self.at_greatest = End::default();
        }
        self.at_greatest.take(value == self.greatest);
        if value < self.least {
            self.least = value;
            self.at_least = End::default();
        }
        self.at_least.take(value == self.least);
        self.last = value;
    }

    fn step(&mut self, step: f64) {
        self.steps.add(step);
        self.largest_steps.add(step);
        let comes_back = (self.step + step).abs() <= BACK * step.abs();
        if comes_back && step > 0.0 {
            self.largest_dips.add(self.step);
        }
        self.step = step;
    }

    pub(crate) fn is_zero(&self) -> bool {
        self.count > 0 && self.zero == self.count
    }
}
