//! Axes: range, ticks, and number format.

use std::ops::Range;

use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use serde::Serialize;

/// One axis.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Axis {
    /// The quantity with its unit: `power (W)`.
    pub label: String,
    /// The scale.
    pub scale: Scale,
    /// Its ends. `None`: the range of the data plus a margin.
    pub limits: Option<[f64; 2]>,
    /// A number within its range, such as 0 for bars.
    pub includes: Option<f64>,
}

/// Scale of an axis.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Scale {
    /// Linear.
    Linear,
    /// Logarithmic. Numbers that are not above 0 are not drawn.
    Log,
    /// Categories, at 0, 1, 2 and so on. On a vertical axis from the top down.
    Names(Vec<String>),
}

impl Axis {
    /// A linear axis over the range of the data.
    pub fn new(label: impl Into<String>) -> Self {
        Self { label: label.into(), scale: Scale::Linear, limits: None, includes: None }
    }

    /// A logarithmic axis.
    pub fn log(label: impl Into<String>) -> Self {
        Self { scale: Scale::Log, ..Self::new(label) }
    }

    /// A categorical axis.
    pub fn names(label: impl Into<String>, names: Vec<String>) -> Self {
        Self { scale: Scale::Names(names), ..Self::new(label) }
    }

    /// With these ends.
    #[must_use]
    pub fn within(mut self, from: f64, to: f64) -> Self {
        self.limits = Some([from, to]);
        self
    }

    /// Extended to `value`.
    #[must_use]
    pub fn including(mut self, value: f64) -> Self {
        self.includes = Some(value);
        self
    }

    /// True if a number can be drawn on it.
    pub(super) fn shows(&self, value: f64) -> bool {
        value.is_finite() && (self.scale != Scale::Log || value > 0.0)
    }

    /// The axis over the range of the data. `None` without data and without ends.
    pub(super) fn spanned(&self, values: impl Iterator<Item = f64>, ticks: usize) -> Option<Span> {
        if let Scale::Names(names) = &self.scale {
            return (!names.is_empty()).then(|| Span::of_names(names));
        }
        let shown = values.chain(self.includes).filter(|value| self.shows(*value));
        let ends = shown.fold(None, |ends: Option<[f64; 2]>, value| {
            let [low, high] = ends.unwrap_or([value, value]);
            Some([low.min(value), high.max(value)])
        });
        let [low, high] = match (self.limits, ends) {
            (Some(limits), _) => limits,
            (None, ends) => ends?,
        };
        let limited = self.limits.is_some();
        match self.scale {
            Scale::Log => Some(Span::of_logarithms(low, high, limited)),
            _ => Some(Span::of_numbers(low, high, limited, ticks)),
        }
    }
}

/// An axis with its ends and ticks: the coordinate of the drawing.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Span {
    low: f64,
    high: f64,
    log: bool,
    downwards: bool,
    pub(super) ticks: Vec<(f64, String)>,
}

impl Span {
    fn of_names(names: &[String]) -> Self {
        let at = |(place, name): (usize, &String)| (place as f64, name.clone());
        Self {
            low: -0.6,
            high: names.len() as f64 - 0.4,
            log: false,
            downwards: true,
            ticks: names.iter().enumerate().map(at).collect(),
        }
    }

    fn of_numbers(mut low: f64, mut high: f64, limited: bool, ticks: usize) -> Self {
        if low >= high {
            let room = if low == 0.0 { 1.0 } else { low.abs() * 0.1 };
            (low, high) = (low - room, low + room);
        } else if !limited {
            let room = (high - low) * 0.04;
            // Bars start at zero, and so does time.
            if low != 0.0 {
                low -= room;
            }
            if high != 0.0 {
                high += room;
            }
        }
        Self { low, high, log: false, downwards: false, ticks: even_ticks(low, high, ticks) }
    }

    fn of_logarithms(low: f64, high: f64, limited: bool) -> Self {
        // Beyond these, quotients of two numbers are not finite.
        let [low, high] = [low, high].map(|end| end.clamp(1e-150, 1e150));
        let high = if high > low { high } else { low * 2.0 };
        let room = if limited { 1.0 } else { libm::pow(high / low, 0.03) };
        let (low, high) = (low / room, high * room);
        Self { low, high, log: true, downwards: false, ticks: log_ticks(low, high) }
    }

    /// Vertical numeric axes point up, categorical ones down.
    pub(super) fn upright(mut self) -> Self {
        if self.downwards {
            (self.low, self.high) = (self.high, self.low);
        }
        self
    }

    pub(super) fn ends(&self) -> [f64; 2] {
        [self.low.min(self.high), self.low.max(self.high)]
    }

    /// Position of a number between the ends, from 0 to 1.
    fn share(&self, value: f64) -> f64 {
        if self.log {
            let (low, high) = (libm::log(self.low), libm::log(self.high));
            (libm::log(value) - low) / (high - low)
        } else {
            (value - self.low) / (self.high - self.low)
        }
    }
}

impl Ranged for Span {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, (from, to): (i32, i32)) -> i32 {
        // A share far outside would overflow i32. Clamping it is invisible, because the drawing is
        // clipped.
        let share = self.share(*value).clamp(-4.0, 5.0);
        from + libm::round(share * f64::from(to - from)) as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, _: Hint) -> Vec<f64> {
        self.ticks.iter().map(|(value, _)| *value).collect()
    }

    fn range(&self) -> Range<f64> {
        self.low..self.high
    }
}

impl ValueFormatter<f64> for Span {
    fn format_ext(&self, value: &f64) -> String {
        let tick = self.ticks.iter().find(|(at, _)| at == value);
        tick.map(|(_, text)| text.clone()).unwrap_or_default()
    }
}

/// About `count` multiples of 1, 2 or 5 times a power of ten.
fn even_ticks(low: f64, high: f64, count: usize) -> Vec<(f64, String)> {
    let rough = (high - low) / count.max(1) as f64;
    let power = libm::floor(libm::log10(rough));
    let unit = libm::pow(10.0, power);
    let step = [1.0, 2.0, 5.0, 10.0]
        .map(|multiple| multiple * unit)
        .into_iter()
        .find(|step| *step >= rough * 0.999)
        .unwrap_or(unit * 10.0);
    if !(step > 0.0 && step.is_finite()) {
        return Vec::new();
    }
    let decimals = (-libm::floor(libm::log10(step) + 1e-9)).max(0.0) as usize;
    let (first, last) = (libm::ceil(low / step - 1e-9), libm::floor(high / step + 1e-9));
    let places = (last - first).clamp(-1.0, 100.0) as i64 + 1;
    let tick = |place: i64| {
        let value = (first + place as f64) * step;
        let value = if value.abs() < step * 1e-6 { 0.0 } else { value };
        (value, written(value, decimals))
    };
    (0..places).map(tick).collect()
}

/// 1, 3 and 10 times the powers of ten. Over many decades only the powers.
fn log_ticks(low: f64, high: f64) -> Vec<(f64, String)> {
    let (first, last) = (libm::floor(libm::log10(low)), libm::ceil(libm::log10(high)));
    let decades = last - first;
    let multiples: &[f64] = match decades {
        ..=4.0 => &[1.0, 3.0],
        _ => &[1.0],
    };
    let every = libm::ceil(decades / 8.0).max(1.0) as usize;
    let powers = (first as i32..=last as i32).step_by(every);
    powers
        .flat_map(|power| {
            let unit = libm::pow(10.0, f64::from(power));
            let decimals = (-power).max(0) as usize;
            multiples.iter().map(move |multiple| {
                let value = multiple * unit;
                (value, written(value, decimals))
            })
        })
        .filter(|(value, _)| (low..=high).contains(value))
        .collect()
}

/// With a proper minus sign, with thousands separators from ten thousand, and with a power of ten
/// for very large or small numbers.
pub(super) fn written(value: f64, decimals: usize) -> String {
    if decimals > 6 || value.abs() >= 1e7 {
        return format!("{value:.1e}").replace('-', "\u{2212}");
    }
    let plain = format!("{:.decimals$}", value.abs());
    let (whole, fraction) = plain.split_once('.').unwrap_or((&plain, ""));
    let mut text = String::new();
    if value < 0.0 {
        text.push('\u{2212}');
    }
    for (place, digit) in whole.chars().enumerate() {
        let left = whole.len() - place;
        if place > 0 && whole.len() > 4 && left % 3 == 0 {
            text.push(',');
        }
        text.push(digit);
    }
    if !fraction.is_empty() {
        text.push('.');
        text.push_str(fraction);
    }
    text
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn texts(span: &Span) -> Vec<&str> {
        span.ticks.iter().map(|(_, text)| text.as_str()).collect()
    }

    #[test]
    fn ticks_are_round_numbers() {
        let axis = Axis::new("x").within(0.0, 1.0);
        let span = axis.spanned([].into_iter(), 5).unwrap();
        assert_eq!(texts(&span), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        let axis = Axis::new("x").within(-50.0, 50.0);
        let span = axis.spanned([].into_iter(), 5).unwrap();
        assert_eq!(texts(&span), ["−40", "−20", "0", "20", "40"]);
        let axis = Axis::log("x").within(1.0, 300.0);
        let span = axis.spanned([].into_iter(), 5).unwrap();
        assert_eq!(texts(&span), ["1", "3", "10", "30", "100", "300"]);
        assert_eq!(written(-12_345.678, 1), "−12,345.7");
        assert_eq!(written(8_450.0, 0), "8450");
        assert_eq!(written(-2.5e90, 0), "−2.5e90");
    }

    #[test]
    fn an_axis_without_numbers_is_none() {
        let nothing = [f64::NAN, f64::INFINITY];
        assert_eq!(Axis::new("x").spanned(nothing.into_iter(), 5), None);
        let below = [0.0, -1.0];
        assert_eq!(Axis::log("x").spanned(below.into_iter(), 5), None);
        let names = Axis::names("x", Vec::new());
        assert_eq!(names.spanned([1.0].into_iter(), 5), None);
    }

    proptest! {
        #[test]
        fn an_axis_contains_its_numbers_and_its_ticks(
            values in proptest::collection::vec(-1e12..1e12f64, 1..20),
            anchored: bool,
            log: bool,
        ) {
            let mut axis = if log { Axis::log("x") } else { Axis::new("x") };
            axis.includes = anchored.then_some(0.0);
            let Some(span) = axis.spanned(values.iter().copied(), 6) else {
                prop_assert!(log && values.iter().all(|value| *value <= 0.0));
                return Ok(());
            };
            let [low, high] = span.ends();
            for value in values.iter().copied().filter(|value| axis.shows(*value)) {
                prop_assert!(low <= value && value <= high, "{low} {value} {high}");
                let place = span.map(&value, (0, 1000));
                prop_assert!((0..=1000).contains(&place), "{value} at {place}");
            }
            for (tick, text) in &span.ticks {
                let slack = (high - low) * 1e-6;
                prop_assert!(low - slack <= *tick && *tick <= high + slack, "{tick}");
                prop_assert!(!text.is_empty());
            }
            prop_assert!(span.ticks.len() <= 40, "{}", span.ticks.len());
        }
    }
}
