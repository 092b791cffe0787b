//! One measured figure.

use serde::{Deserialize, Serialize};

use crate::Distribution;

/// Direction of improvement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Better {
    /// Times, bytes, instructions.
    Less,
    /// Throughputs, shares of a peak, speed-ups.
    More,
}

/// One measured figure: the same name and case denote the same measurement in another run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// Its name, the unit last: `avx512_ns_per_robot`.
    pub name: String,
    /// Its size: `100 robots`.
    pub case: String,
    /// The unit: `ns`, `GMAC/s`, `bytes`. `1` for ratios.
    pub unit: String,
    /// Direction of improvement.
    pub better: Better,
    /// Its repetitions.
    #[serde(flatten)]
    pub spread: Distribution,
}

impl Figure {
    /// A figure for which less is better, such as a time.
    pub fn less(name: &str, case: &str, unit: &str, spread: Distribution) -> Self {
        Self::new(name, case, unit, Better::Less, spread)
    }

    /// A figure for which more is better, such as a throughput.
    pub fn more(name: &str, case: &str, unit: &str, spread: Distribution) -> Self {
        Self::new(name, case, unit, Better::More, spread)
    }

    fn new(name: &str, case: &str, unit: &str, better: Better, spread: Distribution) -> Self {
        Self { name: name.to_owned(), case: case.to_owned(), unit: unit.to_owned(), better, spread }
    }
}

/// A count with thousands separators: `100,000`.
pub(crate) fn grouped(count: u64) -> String {
    let digits = count.to_string();
    let mut text = String::new();
    for (place, digit) in digits.chars().enumerate() {
        if place > 0 && (digits.len() - place).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// The case of a fleet or batch size.
pub(crate) fn robots(count: usize) -> String {
    let plural = if count == 1 { "" } else { "s" };
    format!("{} robot{plural}", grouped(count as u64))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_grouped_by_thousands() {
        for (count, text) in [
            (0, "0"),
            (999, "999"),
            (1_000, "1,000"),
            (300_000, "300,000"),
            (1_234_567, "1,234,567"),
        ] {
            assert_eq!(grouped(count), text);
        }
        assert_eq!(robots(1), "1 robot");
        assert_eq!(robots(7), "7 robots");
    }
}
