//! Figures with machine, build and input, as text and as JSON.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

use crate::{Build, Distribution, Figure, Machine};

/// Version of the layout: figures of other versions are not comparable.
pub const SCHEMA: &str = "joulebus-bench/1";

/// One run: a machine, a build, and the measurements.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Suite {
    /// [`SCHEMA`].
    pub schema: String,
    /// The machine.
    pub machine: Machine,
    /// The build.
    pub build: Build,
    /// The measurements, in their order.
    pub reports: Vec<Report>,
}

/// One measurement.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// `kernel`, `tick`, `rollout`, `latency`.
    pub benchmark: String,
    /// Inputs: model, seed, repetitions, sizes.
    pub input: BTreeMap<String, String>,
    /// Notes on the figures.
    pub notes: Vec<String>,
    /// The figures.
    pub figures: Vec<Figure>,
}

impl Suite {
    /// Reports of this machine and this build.
    pub fn here(reports: Vec<Report>) -> Self {
        Self { schema: SCHEMA.to_owned(), machine: Machine::here(), build: Build::here(), reports }
    }
}

impl Report {
    /// A report without figures.
    pub fn new(benchmark: &str) -> Self {
        Self {
            benchmark: benchmark.to_owned(),
            input: BTreeMap::new(),
            notes: Vec::new(),
            figures: Vec::new(),
        }
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

    /// Adds an input.
    #[must_use]
    pub fn with_input(mut self, name: &str, value: impl fmt::Display) -> Self {
        self.input.insert(name.to_owned(), value.to_string());
        self
    }
}

impl fmt::Display for Suite {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(out, "{}\n{}", self.machine, self.build)?;
        self.reports.iter().try_for_each(|report| write!(out, "\n{report}"))
    }
}

impl fmt::Display for Report {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let input: Vec<String> =
            self.input.iter().map(|(name, value)| format!("{name} {value}")).collect();
        writeln!(out, "{}: {}", self.benchmark, input.join("; "))?;
        let width = |text: fn(&Figure) -> &str| {
            let widths = self.figures.iter().map(|figure| text(figure).len());
            widths.max().unwrap_or(0)
        };
        let (name_width, case_width) = (width(|figure| &figure.name), width(|figure| &figure.case));
        write!(out, "{:<name_width$}  {:<case_width$}", "", "")?;
        for column in ["p50", "p99", "p99.9", "max"] {
            write!(out, " {column:>10}")?;
        }
        writeln!(out, " {:>6}", "n")?;
        let mut name = "";
        for figure in &self.figures {
            let shown = if figure.name == name { "" } else { &figure.name };
            write!(out, "{shown:<name_width$}  {:<case_width$}", figure.case)?;
            let spread = &figure.spread;
            for value in [spread.p50, spread.p99, spread.p999, spread.max] {
                write!(out, " {:>10}", significant(value))?;
            }
            writeln!(out, " {:>6}", spread.count)?;
            name = &figure.name;
        }
        self.notes.iter().try_for_each(|note| writeln!(out, "{note}"))
    }
}

/// Four significant digits.
pub(crate) fn significant(value: f64) -> String {
    let whole_digits = if value == 0.0 { 1 } else { value.abs().log10().floor() as i32 + 1 };
    let decimals = (4 - whole_digits).clamp(0, 9) as usize;
    format!("{value:.decimals$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn suite() -> Suite {
        let spread = Distribution::new(&[150.0, 151.0, 180.0]).expect("there are values");
        let mut report = Report::new("kernel").with_input("seed", 7);
        report.figures = vec![
            Figure::less("avx512_ns_per_robot", "1 robot", "ns", spread),
            Figure::less("avx512_ns_per_robot", "100 robots", "ns", spread),
        ];
        report.notes.push("Hot: the same rows in every repetition.".to_owned());
        Suite::here(vec![report])
    }

    #[test]
    fn json_round_trips() {
        let suite = suite();
        let json = serde_json::to_string(&suite).expect("it is plain data");
        let back: Suite = serde_json::from_str(&json).expect("it was written so");
        assert_eq!(back, suite);
        let value: serde_json::Value = serde_json::from_str(&json).expect("it is JSON");
        let figure = &value["reports"][0]["figures"][0];
        assert_eq!(value["schema"], SCHEMA);
        assert_eq!(figure["p50"], 151.0);
        assert_eq!(figure["unit"], "ns");
        assert_eq!(figure["better"], "less");
    }

    #[test]
    fn text_names_machine_build_input_and_every_figure() {
        let suite = suite();
        let text = suite.to_string();
        for needed in [
            suite.machine.processor.as_str(),
            &suite.build.rustc,
            "seed 7",
            "p99.9",
            "100 robots",
            "151.0",
            "Hot:",
        ] {
            assert!(text.contains(needed), "{needed:?} is missing from\n{text}");
        }
        assert_eq!(text.matches("avx512_ns_per_robot").count(), 1);
    }

    #[test]
    fn figures_are_shown_in_four_digits() {
        for (value, text) in [
            (0.0, "0.000"),
            (0.01234, "0.01234"),
            (1.98765, "1.988"),
            (150.26, "150.3"),
            (23_433.4, "23433"),
        ] {
            assert_eq!(significant(value), text);
        }
    }
}
