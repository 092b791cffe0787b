//! Statistics of one quantity in bounded memory.

use crate::sizes::Sizes;

/// Largest steps between consecutive values that are kept.
pub(crate) const LARGEST: usize = 24;
/// Share of a step by which the way back may differ.
const BACK: f64 = 0.25;

/// The numbers of greatest size, with their signs, in descending size.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Largest([f64; LARGEST]);

impl Largest {
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

    pub(crate) fn numbers(&self) -> &[f64] {
        &self.0[..self.0.partition_point(|number| *number != 0.0)]
    }
}

/// Values of one quantity of one robot.
#[derive(Debug, Clone, Default)]
pub(crate) struct Column {
    pub(crate) count: u64,
    pub(crate) zero: u64,
    pub(crate) negative: u64,
    /// Values outside the range that is known for it.
    pub(crate) outside: u64,
    pub(crate) least: f64,
    pub(crate) greatest: f64,
    /// The values next to them.
    pub(crate) above_least: f64,
    pub(crate) below_greatest: f64,
    /// Values that are equal to the one before.
    pub(crate) repeats: u64,
    /// Steps to a hundredth or to a hundredfold.
    pub(crate) jumps: u64,
    /// Digits after the point that write all values, at most [`Column::CONTINUUM`].
    pub(crate) decimals: u8,
    pub(crate) first: f64,
    pub(crate) last: f64,
    pub(crate) varies: bool,
    pub(crate) sizes: Sizes,
    pub(crate) steps: Sizes,
    pub(crate) at_greatest: End,
    pub(crate) at_least: End,
    pub(crate) largest_steps: Largest,
    /// The largest steps down of those that come back with the next value.
    pub(crate) largest_dips: Largest,
    step: f64,
    pub(crate) moves: Moves,
    pub(crate) spikes: Spikes,
}

/// Steps between successive values, by their direction.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Moves {
    pub(crate) rises: u64,
    pub(crate) falls: u64,
    /// Falls to a tenth or less, where a counter begins again.
    pub(crate) resets: u64,
    /// Sum of all steps without their signs, and of those that lead back to the value before the
    /// last one, and the number of these.
    pub(crate) all: f64,
    pub(crate) back: f64,
    pub(crate) returns: u64,
}

/// Values a hundred times those before them, all of about one size.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Spikes {
    /// Their number, and that of the readings that they last.
    pub(crate) count: u64,
    pub(crate) readings: u64,
    pub(crate) least: f64,
    pub(crate) greatest: f64,
    /// Those after a value of less than a two-hundredth of their size.
    pub(crate) from_zero: u64,
}

impl Spikes {
    fn take(&mut self, before: f64, value: f64) {
        if value > 2.0 * self.greatest && value >= 100.0 * before.abs() {
            *self = Self { least: value, greatest: value, ..Self::default() };
        }
        let top = 0.5 * self.greatest;
        if !(self.greatest > 0.0 && value >= top) {
            return;
        }
        self.readings += 1;
        (self.least, self.greatest) = (self.least.min(value), self.greatest.max(value));
        if before < top {
            self.count += 1;
            self.from_zero += u64::from(200.0 * before.abs() <= self.greatest);
        }
    }
}

/// Values equal to an end of the range.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct End {
    pub(crate) count: u64,
    pub(crate) runs: u64,
    /// Values at the end since the last one that was not.
    run: u64,
    pub(crate) longest: u64,
}

impl End {
    fn take(&mut self, is_at_end: bool) {
        self.run = if is_at_end { self.run + 1 } else { 0 };
        self.runs += u64::from(self.run == 1);
        self.count += u64::from(is_at_end);
        self.longest = self.longest.max(self.run);
    }
}

impl Column {
    /// Digits of a continuum: more than any file has.
    pub(crate) const CONTINUUM: u8 = 9;

    pub(crate) fn new() -> Self {
        Self {
            least: f64::INFINITY,
            greatest: f64::NEG_INFINITY,
            above_least: f64::INFINITY,
            below_greatest: f64::NEG_INFINITY,
            first: f64::NAN,
            last: f64::NAN,
            ..Self::default()
        }
    }

    /// Takes a value. NaN and infinities are none.
    pub(crate) fn take(&mut self, value: f64, range: Option<(f64, f64)>) {
        if !value.is_finite() {
            return;
        }
        if self.count == 0 {
            self.first = value;
        } else {
            self.varies |= value != self.first;
            // NaN before the first value of a recording.
            if self.last.is_finite() {
                self.repeats += u64::from(value == self.last);
                let ratio = (value / self.last).abs();
                let is_jump = ratio.is_finite() && ratio > 0.0 && !(1e-2..=1e2).contains(&ratio);
                self.jumps += u64::from(is_jump);
                self.step(value);
            }
        }
        self.count += 1;
        self.zero += u64::from(value == 0.0);
        self.negative += u64::from(value < 0.0);
        let is_outside =
            range.is_some_and(|(least, greatest)| !(least <= value && value <= greatest));
        self.outside += u64::from(is_outside);
        self.sizes.add(value);
        if value > self.greatest {
            self.below_greatest = self.greatest;
            self.greatest = value;
            self.at_greatest = End::default();
        }
        self.at_greatest.take(value == self.greatest);
        if value < self.greatest {
            self.below_greatest = self.below_greatest.max(value);
        }
        if value < self.least {
            self.above_least = self.least;
            self.least = value;
            self.at_least = End::default();
        }
        self.at_least.take(value == self.least);
        if value > self.least {
            self.above_least = self.above_least.min(value);
        }
        while self.decimals < Self::CONTINUUM && !is_whole(value, self.decimals) {
            self.decimals += 1;
        }
        self.last = value;
    }

    fn step(&mut self, value: f64) {
        let step = value - self.last;
        self.spikes.take(self.last, value);
        self.steps.add(step);
        self.largest_steps.add(step);
        let comes_back = (self.step + step).abs() <= BACK * step.abs();
        if comes_back && step > 0.0 {
            self.largest_dips.add(self.step);
        }
        let moves = &mut self.moves;
        moves.rises += u64::from(step > 0.0);
        moves.falls += u64::from(step < 0.0);
        moves.resets += u64::from(step < 0.0 && value <= 0.1 * self.last);
        moves.all += step.abs();
        if comes_back && step != 0.0 {
            moves.back += step.abs();
            moves.returns += 1;
        }
        self.step = step;
    }

    /// Begins another recording: its first value follows none.
    pub(crate) fn begin(&mut self) {
        (self.last, self.step) = (f64::NAN, 0.0);
        (self.at_greatest.run, self.at_least.run) = (0, 0);
    }

    pub(crate) fn is_zero(&self) -> bool {
        self.count > 0 && self.zero == self.count
    }
}

/// True if a value has no more digits after the point.
fn is_whole(value: f64, decimals: u8) -> bool {
    let scaled = value * 10f64.powi(decimals.into());
    (scaled - scaled.round()).abs() <= 1e-4 + 1e-9 * scaled.abs()
}
