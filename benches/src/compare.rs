//! Comparison of two runs.

use std::fmt;

use serde::Serialize;

use crate::report::significant;
use crate::{Better, Distribution, Figure, SCHEMA, Suite};

/// Errors of a comparison.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum CompareError {
    /// The old figures have another layout.
    #[error(
        "the old figures have the layout {found:?}, allowed is {SCHEMA:?}: measure again with this version"
    )]
    Schema {
        /// The layout in the file.
        found: String,
    },
    /// The runs have no figure in common.
    #[error(
        "none of the {new} new figures is among the {old} old ones: compare the same benchmark with the same sizes"
    )]
    NothingInCommon {
        /// Figures of the earlier run.
        old: usize,
        /// Figures of this run.
        new: usize,
    },
}

/// Change of a figure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The interquartile ranges of both runs overlap.
    WithinNoise,
    /// Better beyond noise.
    Better,
    /// Worse beyond noise.
    Worse,
}

/// One figure in both runs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Change {
    /// The benchmark.
    pub benchmark: String,
    /// The figure.
    pub name: String,
    /// Its case.
    pub case: String,
    /// Its unit.
    pub unit: String,
    /// The earlier run.
    pub old: Distribution,
    /// This run.
    pub new: Distribution,
    /// Median of the earlier run over that of this one.
    pub old_over_new: f64,
    /// Factor by which this run is worse: above 1 is worse, whichever direction is better.
    pub times_worse: f64,
    /// Verdict whether the change exceeds noise.
    pub verdict: Verdict,
}

/// Comparison with an earlier run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// Differences of machine and build.
    pub differing: Vec<String>,
    /// Figures in both.
    pub changes: Vec<Change>,
    /// Figures that only the earlier run has.
    pub only_old: Vec<String>,
    /// Figures that only this run has.
    pub only_new: Vec<String>,
}

impl Comparison {
    /// Compares figures of the same benchmark, name, case and unit.
    ///
    /// # Errors
    /// [`CompareError`]: another layout, or nothing in common.
    pub fn new(old: &Suite, new: &Suite) -> Result<Self, CompareError> {
        if old.schema != new.schema {
            return Err(CompareError::Schema { found: old.schema.clone() });
        }
        let (before, now) = (keyed(old), keyed(new));
        let changes: Vec<Change> = now
            .iter()
            .filter_map(|(key, figure)| {
                let (_, old) = before.iter().find(|(other, _)| other == key)?;
                Some(change(key, old, figure))
            })
            .collect();
        if changes.is_empty() {
            return Err(CompareError::NothingInCommon { old: before.len(), new: now.len() });
        }
        Ok(Self {
            differing: differing(old, new),
            changes,
            only_old: missing(&before, &now),
            only_new: missing(&now, &before),
        })
    }

    /// Figures that are more than `ratio` times worse, beyond noise.
    pub fn worse_than(&self, ratio: f64) -> impl Iterator<Item = &Change> {
        self.changes
            .iter()
            .filter(move |change| change.verdict == Verdict::Worse && change.times_worse > ratio)
    }
}

/// Benchmark, name, case, unit: identify a measurement.
type Key<'a> = [&'a str; 4];

fn keyed(suite: &Suite) -> Vec<(Key<'_>, &Figure)> {
    suite
        .reports
        .iter()
        .flat_map(|report| {
            report.figures.iter().map(|figure| {
                let Figure { name, case, unit, .. } = figure;
                ([report.benchmark.as_str(), name, case, unit], figure)
            })
        })
        .collect()
}

fn change(key: &Key<'_>, old: &Figure, new: &Figure) -> Change {
    let [benchmark, name, case, unit] = key.map(str::to_owned);
    let old_over_new = old.spread.p50 / new.spread.p50;
    let times_worse = match new.better {
        Better::Less => 1.0 / old_over_new,
        Better::More => old_over_new,
    };
    let verdict = match new.spread.differs_from(&old.spread) {
        false => Verdict::WithinNoise,
        true if times_worse > 1.0 => Verdict::Worse,
        true => Verdict::Better,
    };
    Change {
        benchmark,
        name,
        case,
        unit,
        old: old.spread,
        new: new.spread,
        old_over_new,
        times_worse,
        verdict,
    }
}

fn missing(these: &[(Key<'_>, &Figure)], those: &[(Key<'_>, &Figure)]) -> Vec<String> {
    let in_those = |key: &Key<'_>| those.iter().any(|(other, _)| other == key);
    these
        .iter()
        .filter(|(key, _)| !in_those(key))
        .map(|([benchmark, name, case, _], _)| format!("{benchmark} {name}, {case}"))
        .collect()
}

fn differing(old: &Suite, new: &Suite) -> Vec<String> {
    let mut differing = Vec::new();
    if old.machine != new.machine {
        differing.push(format!("machine: {} before, now {}", old.machine, new.machine));
    }
    if old.build != new.build {
        differing.push(format!("build: {} before, now {}", old.build, new.build));
    }
    for report in &new.reports {
        let same = |other: &&crate::Report| other.benchmark == report.benchmark;
        let Some(before) = old.reports.iter().find(same) else {
            continue;
        };
        for (name, value) in &report.input {
            let was = before.input.get(name);
            if was.is_some_and(|was| was != value) {
                let benchmark = &report.benchmark;
                let was = was.map_or("", String::as_str);
                differing.push(format!("{benchmark}: {name} {was} before, now {value}"));
            }
        }
    }
    differing
}

impl fmt::Display for Comparison {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for line in &self.differing {
            writeln!(out, "differs, {line}")?;
        }
        let titles: Vec<String> = self
            .changes
            .iter()
            .map(|change| format!("{} {}, {}", change.benchmark, change.name, change.case))
            .collect();
        let width = titles.iter().map(String::len).max().unwrap_or(0);
        writeln!(
            out,
            "{:<width$} {:>10} {:>10} {:>8}  interquartile range, old and new",
            "", "old", "new", "old/new"
        )?;
        for (title, change) in titles.iter().zip(&self.changes) {
            write_change(out, title, width, change)?;
        }
        for (when, names) in [("before", &self.only_old), ("now", &self.only_new)] {
            for name in names {
                writeln!(out, "only {when}: {name}")?;
            }
        }
        writeln!(out, "noise: the interquartile ranges of both runs overlap. Medians are compared")
    }
}

fn write_change(
    out: &mut fmt::Formatter<'_>,
    title: &str,
    width: usize,
    change: &Change,
) -> fmt::Result {
    let Change { old, new, .. } = change;
    let verdict = match change.verdict {
        Verdict::WithinNoise => "",
        Verdict::Better => "  better",
        Verdict::Worse => "  WORSE",
    };
    writeln!(
        out,
        "{title:<width$} {:>10} {:>10} {:>8.3}  {}–{}, {}–{}{verdict}",
        significant(old.p50),
        significant(new.p50),
        change.old_over_new,
        significant(old.p25),
        significant(old.p75),
        significant(new.p25),
        significant(new.p75),
    )
}
