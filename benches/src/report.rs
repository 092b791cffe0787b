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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_and_json_have_machine_build_input_and_every_figure() {
        let spread = Distribution::new(&[150.0, 151.0, 180.0]).expect("there are values");
        let mut report = Report::new("kernel").with_input("seed", 7);
        report.figures = vec![Figure::less("avx512_ns_per_robot", "100 robots", "ns", spread)];
        report.notes.push("Hot: the same rows in every repetition.".to_owned());
        let suite = Suite::here(vec![report]);
        let value = serde_json::to_value(&suite).expect("it is plain data");
        let figure = &value["reports"][0]["figures"][0];
        assert_eq!((&value["schema"], &figure["p50"]), (&SCHEMA.into(), &151.0.into()));
        assert_eq!((&figure["unit"], &figure["better"]), (&"ns".into(), &"less".into()));
        let text = suite.to_string();
        let (processor, rustc) = (shown(&suite.machine["processor"]), shown(&suite.build["rustc"]));
        for needed in [&processor, &rustc, "seed 7", "p99.9", "100 robots", "151.0", "Hot:"] {
            assert!(text.contains(needed), "{needed:?} is missing from\n{text}");
        }
    }

    #[test]
    fn figures_are_shown_in_four_digits() {
        for (value, text) in
            [(0.0, "0.000"), (0.01234, "0.01234"), (150.26, "150.3"), (23_433.4, "23433")]
        {
            assert_eq!(significant(value), text);
        }
    }
}
