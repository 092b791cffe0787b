//! Comparison of two runs.

use std::fmt;

use serde::Serialize;

use crate::machine::Facts;
use crate::report::{shown, significant};
use crate::{Better, Distribution, Figure, SCHEMA, Suite};

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
    /// Benchmark, name and case.
    pub name: String,
    /// Its unit.
    pub unit: String,
    /// The earlier run.
    pub old: Distribution,
    /// This run.
    pub new: Distribution,
    /// Factor by which this run is worse: above 1 is worse, whichever direction is better.
    pub times_worse: f64,
    /// Verdict whether the change exceeds noise.
    pub verdict: Verdict,
}

/// Comparison with an earlier run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// Differences of machine, build and inputs.
    pub differing: Vec<String>,
    /// Figures in both.
    pub changes: Vec<Change>,
    /// Figures in one run only, with that run.
    pub missing: Vec<String>,
}

impl Comparison {
    /// Compares figures of the same benchmark, name, case and unit.
    ///
    /// # Errors
    /// The earlier run has another layout, or nothing in common.
    pub fn new(old: &Suite, new: &Suite) -> anyhow::Result<Self> {
        anyhow::ensure!(
            old.schema == new.schema,
            "the old figures have the layout {:?}, allowed is {SCHEMA:?}: measure again with this version",
            old.schema
        );
        let (before, now) = (named(old), named(new));
        let same = |name: &str, unit: &str, among: &[(String, &Figure)]| {
            among.iter().position(|(other, figure)| other == name && figure.unit == unit)
        };
        let (mut changes, mut missing) = (Vec::new(), Vec::new());
        for (name, figure) in &now {
            match same(name, &figure.unit, &before) {
                Some(place) => changes.push(Change::new(name, before[place].1, figure)),
                None => missing.push(format!("only now: {name}")),
            }
        }
        let gone = before.iter().filter(|(name, figure)| same(name, &figure.unit, &now).is_none());
        missing.extend(gone.map(|(name, _)| format!("only before: {name}")));
        anyhow::ensure!(
            !changes.is_empty(),
            "none of the {} new figures is among the {} old ones: compare the same benchmark with the same sizes",
            now.len(),
            before.len()
        );
        Ok(Self { differing: differing(old, new), changes, missing })
    }

    /// Figures that are more than `ratio` times worse, beyond noise.
    pub fn worse_than(&self, ratio: f64) -> impl Iterator<Item = &Change> {
        let worse = self.changes.iter().filter(|change| change.verdict == Verdict::Worse);
        worse.filter(move |change| change.times_worse > ratio)
    }
}

fn named(suite: &Suite) -> Vec<(String, &Figure)> {
    let figures = suite
        .reports
        .iter()
        .flat_map(|report| report.figures.iter().map(|figure| (report.benchmark.as_str(), figure)));
    figures.map(|(of, figure)| (format!("{of} {}, {}", figure.name, figure.case), figure)).collect()
}

impl Change {
    fn new(name: &str, old: &Figure, new: &Figure) -> Self {
        let (unit, old, better, new) = (new.unit.clone(), old.spread, new.better, new.spread);
        let times_worse = match better {
            Better::Less => new.p50 / old.p50,
            Better::More => old.p50 / new.p50,
        };
        let verdict = match new.differs_from(&old) {
            false => Verdict::WithinNoise,
            true if times_worse > 1.0 => Verdict::Worse,
            true => Verdict::Better,
        };
        Self { name: name.to_owned(), unit, old, new, times_worse, verdict }
    }
}

fn differing(old: &Suite, new: &Suite) -> Vec<String> {
    let mut of = vec![("machine", &old.machine, &new.machine), ("build", &old.build, &new.build)];
    for now in &new.reports {
        let before = old.reports.iter().find(|before| before.benchmark == now.benchmark);
        of.extend(before.map(|before| (now.benchmark.as_str(), &before.input, &now.input)));
    }
    let changed = |(of, before, now): (&str, &Facts, &Facts)| {
        let both = now.iter().filter_map(|(name, value)| Some((name, before.get(name)?, value)));
        let changed = both.filter(|(_, was, value)| was != value).map(|(name, was, value)| {
            format!("{of}: {name} {} before, now {}", shown(was), shown(value))
        });
        changed.collect::<Vec<_>>()
    };
    of.into_iter().flat_map(changed).collect()
}

impl fmt::Display for Comparison {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.differing.iter().try_for_each(|line| writeln!(out, "differs, {line}"))?;
        let width = self.changes.iter().map(|change| change.name.len()).max().unwrap_or(0);
        let [old, new, worse] = ["old", "new", "worse"];
        writeln!(out, "{:<width$} {old:>10} {new:>10} {worse:>8}  interquartile ranges", "")?;
        for Change { name, old, new, times_worse, verdict, .. } in &self.changes {
            let [p50, now] = [old.p50, new.p50].map(significant);
            let [a, b, c, d] = [old.p25, old.p75, new.p25, new.p75].map(significant);
            let verdict = match verdict {
                Verdict::WithinNoise => "",
                Verdict::Better => "  better",
                Verdict::Worse => "  WORSE",
            };
            writeln!(
                out,
                "{name:<width$} {p50:>10} {now:>10} {times_worse:>7.3}×  {a}–{b}, {c}–{d}{verdict}"
            )?;
        }
        self.missing.iter().try_for_each(|line| writeln!(out, "{line}"))?;
        writeln!(out, "noise: the interquartile ranges of both runs overlap. Medians are compared")
    }
}
