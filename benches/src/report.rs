//! Figures with machine, build and input, as text and as JSON.

use std::fmt;

use joulebus_latency::Spread;
use serde::Serialize;
use serde_json::Value;

use crate::machine::{self, Facts};

/// Version of the layout: figures of other versions are not comparable.
const SCHEMA: &str = "joulebus-bench/1";

/// One run: a machine, a build, and the measurements.
#[derive(Debug, Serialize)]
pub struct Suite {
    schema: &'static str,
    machine: Facts,
    build: Facts,
    reports: Vec<Report>,
}

#[derive(Debug, Default, Serialize)]
pub struct Report {
    benchmark: String,
    /// Model, kernel, seed, times, sizes.
    input: Facts,
    /// Notes on the figures.
    pub notes: Vec<String>,
    figures: Vec<Figure>,
}

/// One measured figure: the same name and case denote the same measurement in another run.
#[derive(Debug, Serialize)]
struct Figure {
    /// Its unit last: `avx512_ns_per_robot`.
    name: String,
    /// Its size: `100 robots`.
    case: String,
    /// `ns`, `GMAC/s`, `bytes`, or `1` for ratios.
    unit: &'static str,
    /// `less` or `more`.
    better: &'static str,
    #[serde(flatten)]
    spread: Distribution,
}

/// Distribution of one figure over its repetitions, in the figure's unit.
///
/// Quantiles are nearest ranks: each is a measured value. Below 1000 repetitions `p999` is the
/// maximum, below 100 `p99` is too.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct Distribution {
    count: u64,
    min: f64,
    p25: f64,
    p50: f64,
    p75: f64,
    p99: f64,
    p999: f64,
    max: f64,
}

impl Distribution {
    /// `None` if there are no values, or if one is not finite.
    fn new(values: &[f64]) -> Option<Self> {
        let is_measured = !values.is_empty() && values.iter().all(|value| value.is_finite());
        let shares = [0.0, 0.25, 0.5, 0.75, 0.99, 0.999, 1.0];
        let [min, p25, p50, p75, p99, p999, max] = shares.map(|share| quantile(values, share));
        is_measured.then_some(Self {
            count: values.len() as u64,
            min,
            p25,
            p50,
            p75,
            p99,
            p999,
            max,
        })
    }
}

/// A quantile of measured values by nearest rank, NaN if there are none.
pub(crate) fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied().unwrap_or(f64::NAN)
}

impl Suite {
    /// Reports of this machine and this build.
    pub fn here(reports: Vec<Report>) -> Self {
        Self { schema: SCHEMA, machine: machine::machine(), build: machine::build(), reports }
    }
}

impl Report {
    /// A report without figures.
    pub fn new(benchmark: &str) -> Self {
        Self { benchmark: benchmark.to_owned(), ..Self::default() }
    }

    #[must_use]
    pub fn with_input(mut self, name: &str, value: impl fmt::Display) -> Self {
        self.input.insert(name.to_owned(), value.to_string().into());
        self
    }

    /// Adds a figure for which less is better, such as a time, unless a value is not finite.
    pub fn less(&mut self, name: &str, case: &str, unit: &'static str, values: &[f64]) {
        self.push(name, case, unit, "less", Distribution::new(values));
    }

    /// The same for which more is better, such as a throughput.
    pub fn more(&mut self, name: &str, case: &str, unit: &'static str, values: &[f64]) {
        self.push(name, case, unit, "more", Distribution::new(values));
    }

    /// Adds times that were measured, if there are any.
    pub fn times(&mut self, name: &str, case: &str, times: &Spread) {
        let all = Distribution {
            count: times.count,
            min: times.min_us,
            p25: times.p25_us,
            p50: times.p50_us,
            p75: times.p75_us,
            p99: times.p99_us,
            p999: times.p999_us,
            max: times.max_us,
        };
        self.push(name, case, "µs", "less", (times.count > 0).then_some(all));
    }

    fn push(
        &mut self,
        name: &str,
        case: &str,
        unit: &'static str,
        better: &'static str,
        spread: Option<Distribution>,
    ) {
        let [name, case] = [name, case].map(str::to_owned);
        self.figures.extend(spread.map(|spread| Figure { name, case, unit, better, spread }));
    }
}

/// A count with thousands separators: `100,000`.
pub(crate) fn grouped(count: usize) -> String {
    let (rest, last) = (count / 1000, count % 1000);
    if rest == 0 { last.to_string() } else { format!("{},{last:03}", grouped(rest)) }
}

/// The case of a fleet or batch size.
pub(crate) fn robots(count: usize) -> String {
    format!("{} robot{}", grouped(count), if count == 1 { "" } else { "s" })
}

fn listed(facts: &Facts) -> String {
    let shown = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
    let facts = facts.iter().map(|(name, value)| format!("{name} {}", shown(value)));
    facts.collect::<Vec<_>>().join(", ")
}

impl fmt::Display for Suite {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(out, "{}\n{}", listed(&self.machine), listed(&self.build))?;
        self.reports.iter().try_for_each(|report| write!(out, "\n{report}"))
    }
}

impl fmt::Display for Report {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(out, "{}: {}", self.benchmark, listed(&self.input))?;
        let title = |figure: &Figure| format!("{}  {}", figure.name, figure.case);
        let width = self.figures.iter().map(|figure| title(figure).len()).max().unwrap_or(0);
        let [p50, p99, p999, max, n] = ["p50", "p99", "p99.9", "max", "n"];
        writeln!(out, "{:<width$} {p50:>10} {p99:>10} {p999:>10} {max:>10} {n:>6}", "")?;
        for figure in &self.figures {
            let Distribution { p50, p99, p999, max, count, .. } = figure.spread;
            let [p50, p99, p999, max] = [p50, p99, p999, max].map(significant);
            let title = title(figure);
            writeln!(out, "{title:<width$} {p50:>10} {p99:>10} {p999:>10} {max:>10} {count:>6}")?;
        }
        self.notes.iter().try_for_each(|note| writeln!(out, "{note}"))
    }
}

fn significant(value: f64) -> String {
    let whole_digits = if value == 0.0 { 1 } else { value.abs().log10().floor() as i32 + 1 };
    let decimals = (4 - whole_digits).clamp(0, 9) as usize;
    format!("{value:.decimals$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_measured_values() {
        let values: Vec<f64> = (1..=1000).rev().map(f64::from).collect();
        let all = Distribution::new(&values).expect("there are values");
        let found = [all.min, all.p25, all.p50, all.p75, all.p99, all.p999, all.max];
        assert_eq!(found, [1.0, 250.0, 500.0, 750.0, 990.0, 999.0, 1000.0]);
    }

    #[test]
    fn no_values_or_values_that_are_not_finite_give_no_figure() {
        for values in [&[][..], &[1.0, f64::NAN], &[f64::INFINITY]] {
            assert_eq!(Distribution::new(values), None, "{values:?}");
        }
    }
}
