//! One measured figure.

use serde::Serialize;

use crate::Distribution;

/// Direction of improvement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Better {
    /// Times, bytes.
    Less,
    /// Throughputs, shares of a peak, speed-ups.
    More,
}

/// One measured figure: the same name and case denote the same measurement in another run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Figure {
    /// Its name, the unit last: `avx512_ns_per_robot`.
    pub name: String,
    /// Its size: `100 robots`.
    pub case: String,
    /// The unit: `ns`, `GMAC/s`, `bytes`. `1` for ratios.
    pub unit: String,
    pub better: Better,
    /// Its repetitions.
    #[serde(flatten)]
    pub spread: Distribution,
}

impl Figure {
    /// A figure for which less is better, such as a time.
    pub fn less(name: &str, case: &str, unit: &str, spread: Distribution) -> Self {
        let [name, case, unit] = [name, case, unit].map(str::to_owned);
        Self { name, case, unit, better: Better::Less, spread }
    }

    /// A figure for which more is better, such as a throughput.
    pub fn more(name: &str, case: &str, unit: &str, spread: Distribution) -> Self {
        Self { better: Better::More, ..Self::less(name, case, unit, spread) }
    }
}

/// A count with thousands separators: `100,000`.
pub(crate) fn grouped(count: u64) -> String {
    let (rest, last) = (count / 1000, count % 1000);
    if rest == 0 { last.to_string() } else { format!("{},{last:03}", grouped(rest)) }
}

/// The case of a fleet or batch size.
pub(crate) fn robots(count: usize) -> String {
    let plural = if count == 1 { "" } else { "s" };
    format!("{} robot{plural}", grouped(count as u64))
}
