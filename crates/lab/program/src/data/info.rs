//! `joulebus data info`: describes recordings.

use std::collections::BTreeSet;
use std::fmt;

use joulebus_dataset::inspect::{Holds, TrialReport, describe};
use joulebus_dataset::trial::{Trial, TrialError};
use joulebus_program::exit::Outcome;
use joulebus_program::output::Output;
use serde::Serialize;

use crate::recordings::Recordings;

/// Show rows, rate, gaps, held readings, ranges and missing columns of recorded trials
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus data info recordings/*.csv.gz\n  \
    joulebus data info 'runs/**/*.npy'\n  \
    joulebus data info a.npy --format json\n\n\
    Held readings equal those of the row before to the bit: power, voltage and current. If most readings \
    are held for three rows at 30 Hz, the sensor is read ten times a second.")]
pub(super) struct Args {
    #[command(flatten)]
    recordings: Recordings,
}

#[derive(Debug, Serialize)]
struct DataInfoReport {
    trials: Vec<TrialReport>,
    sums: Sums,
}

/// Totals over all trials.
#[derive(Debug, Serialize)]
struct Sums {
    trials: usize,
    robots: Vec<String>,
    groups: Vec<String>,
    rows: usize,
    duration_s: f64,
    energy_j: f64,
    gaps: usize,
    held_readings: usize,
    missing_readings: usize,
}

pub(super) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let mut trials = Vec::new();
    let map = args.recordings.map();
    for file in args.recordings.find()? {
        Trial::each(file, &map, |trial| {
            trials.push(describe(&trial));
            Ok::<_, TrialError>(())
        })?;
    }
    let sums = Sums::new(&trials);
    output.report(&DataInfoReport { trials, sums })?;
    Ok(Outcome::Done)
}

impl Sums {
    fn new(trials: &[TrialReport]) -> Self {
        let robots = trials.iter().filter_map(|trial| trial.robot_name.clone());
        let groups = trials.iter().map(|trial| trial.group.clone());
        let count = |of: fn(&TrialReport) -> usize| trials.iter().map(of).sum();
        Self {
            trials: trials.len(),
            robots: robots.collect::<BTreeSet<_>>().into_iter().collect(),
            groups: groups.collect::<BTreeSet<_>>().into_iter().collect(),
            rows: count(|trial| trial.rows),
            duration_s: trials.iter().map(|trial| trial.duration_s).sum(),
            energy_j: trials.iter().map(|trial| trial.energy_j).sum(),
            gaps: count(|trial| trial.gaps),
            held_readings: count(|trial| trial.held_readings),
            missing_readings: count(|trial| trial.missing_readings),
        }
    }
}

impl fmt::Display for DataInfoReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for trial in &self.trials {
            write_trial(out, trial)?;
        }
        match self.trials.as_slice() {
            // The ranges of many would hide the rest. In JSON all are there.
            [only] => write_columns(out, only),
            _ => write_sums(out, &self.sums),
        }
    }
}

fn write_sums(out: &mut fmt::Formatter<'_>, sums: &Sums) -> fmt::Result {
    let Sums { trials, rows, duration_s, energy_j, gaps, held_readings, missing_readings, .. } =
        sums;
    writeln!(
        out,
        "{trials} trials of {} robots in {} groups: {rows} rows, {duration_s:.0} s, {energy_j:.0} J",
        sums.robots.len(),
        sums.groups.len()
    )?;
    writeln!(out, "  readings held {held_readings}, missing {missing_readings}; {gaps} gaps")?;
    writeln!(out, "  groups: {}", some(&sums.groups))
}

/// The first of many names.
fn some(names: &[String]) -> String {
    match names.len() {
        ..=12 => names.join(", "),
        more => format!("{}, … ({more})", names[..12].join(", ")),
    }
}

fn write_trial(out: &mut fmt::Formatter<'_>, trial: &TrialReport) -> fmt::Result {
    let robot = trial.robot_name.as_deref().unwrap_or("no name");
    writeln!(out, "{} (robot {robot})", trial.file.display())?;
    let (rows, rate, duration) = (trial.rows, trial.rate_hz, trial.duration_s);
    let (least_ms, greatest_ms) = (trial.steps.p05_s * 1e3, trial.steps.p95_s * 1e3);
    writeln!(
        out,
        "  {rows} rows at {rate:.2} Hz, {duration:.1} s; nine of ten steps {least_ms:.1} to \
         {greatest_ms:.1} ms"
    )?;
    if let (Some(mean), Some(least), Some(greatest)) =
        (trial.mean_power_w, trial.least_power_w, trial.greatest_power_w)
    {
        let energy = trial.energy_j;
        writeln!(out, "  power {mean:.2} W, {least:.2} to {greatest:.2} W; energy {energy:.1} J")?;
    }
    if let Some(check) = &trial.power_check {
        let (ratio, rows) = (check.median_ratio, check.rows);
        writeln!(out, "  power is {ratio:.4} times voltage times current (median of {rows} rows)")?;
    }
    write_holds(out, &trial.holds, trial.missing_readings)?;
    if let Some(longest) = trial.longest_gap_s {
        writeln!(out, "  {} gaps, the longest {longest:.3} s", trial.gaps)?;
    }
    if trial.not_advancing > 0 {
        let rows = trial.not_advancing;
        writeln!(out, "  {rows} rows whose time does not advance")?;
    }
    if trial.unnamed_rows > 0 {
        writeln!(out, "  {} rows without a robot name", trial.unnamed_rows)?;
    }
    let lists = [
        ("without", trial.missing_columns.join(" ")),
        ("never changing", trial.constant_columns.join(" ")),
        ("not read", trial.ignored_columns.join(" ")),
    ];
    for (what, names) in lists.iter().filter(|(_, names)| !names.is_empty()) {
        writeln!(out, "  {what}: {names}")?;
    }
    if trial.no_final_line_break {
        writeln!(out, "  the last line has no newline: the file may be truncated")?;
    }
    Ok(())
}

fn write_holds(out: &mut fmt::Formatter<'_>, holds: &Holds, missing: usize) -> fmt::Result {
    let (held, share) = (holds.held, 100.0 * holds.share);
    write!(out, "  readings held {held} ({share:.1} %), missing {missing}")?;
    if holds.held == 0 {
        return writeln!(out);
    }
    let Holds { usual_rows, new_hz, longest_rows, longest_at_row, longest_s, .. } = holds;
    let usual = 100.0 * holds.usual_share;
    writeln!(
        out,
        "; {usual:.0} % are held for {usual_rows} row{}, {new_hz:.2} new a second, the longest for \
         {longest_rows} rows, {longest_s:.2} s, from row {longest_at_row}",
        if *usual_rows == 1 { "" } else { "s" }
    )
}

fn write_columns(out: &mut fmt::Formatter<'_>, trial: &TrialReport) -> fmt::Result {
    writeln!(
        out,
        "  {:18}{:>8}{:>13}{:>13}{:>13}{:>13}",
        "column, SI units", "values", "least", "mean", "std", "greatest"
    )?;
    for column in &trial.columns {
        writeln!(
            out,
            "  {:18}{:>8}{:>13.5}{:>13.5}{:>13.5}{:>13.5}",
            column.name, column.values, column.least, column.mean, column.std, column.greatest
        )?;
    }
    Ok(())
}
