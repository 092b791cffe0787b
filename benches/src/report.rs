//! Figures with machine, build and input, as text and as JSON.

use std::fmt;

use serde::Serialize;
use serde_json::Value;

use crate::machine::{self, Facts};
use crate::{Distribution, Figure};

/// Version of the layout: figures of other versions are not comparable.
pub const SCHEMA: &str = "joulebus-bench/1";

/// One run: a machine, a build, and the measurements.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Suite {
    /// [`SCHEMA`].
    pub schema: String,
    pub machine: Facts,
    pub build: Facts,
    /// The measurements, in their order.
    pub reports: Vec<Report>,
}

#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Report {
    /// `kernel`, `tick`, `rollout`, `latency`.
    pub benchmark: String,
    /// Inputs: model, seed, repetitions, sizes.
    pub input: Facts,
    /// Notes on the figures.
    pub notes: Vec<String>,
    pub figures: Vec<Figure>,
}

impl Suite {
    /// Reports of this machine and this build.
    pub fn here(reports: Vec<Report>) -> Self {
        let (machine, build) = (machine::machine(), machine::build());
        Self { schema: SCHEMA.to_owned(), machine, build, reports }
    }
}

impl Report {
    /// A report without figures.
    pub fn new(benchmark: &str) -> Self {
        Self { benchmark: benchmark.to_owned(), ..Self::default() }
    }

    /// Adds a figure, unless a value is missing or not finite.
    pub fn push(
        &mut self,
        figure: fn(&str, &str, &str, Distribution) -> Figure,
        name: &str,
        case: &str,
        unit: &str,
        values: &[f64],
    ) {
        let spread = Distribution::new(values);
        self.figures.extend(spread.map(|spread| figure(name, case, unit, spread)));
    }

    #[must_use]
    pub fn with_input(mut self, name: &str, value: impl fmt::Display) -> Self {
        self.input.insert(name.to_owned(), value.to_string().into());
        self
    }
}

/// A property without the quotes of JSON.
pub(crate) fn shown(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

fn listed(facts: &Facts) -> String {
    let facts: Vec<_> =
        facts.iter().map(|(name, value)| format!("{name} {}", shown(value))).collect();
    facts.join(", ")
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

pub(crate) fn significant(value: f64) -> String {
    let whole_digits = if value == 0.0 { 1 } else { value.abs().log10().floor() as i32 + 1 };
    let decimals = (4 - whole_digits).clamp(0, 9) as usize;
    format!("{value:.decimals$}")
}
