//! `joulebus data`: datasets.

use std::fmt;
use std::path::PathBuf;

use clap::Subcommand;
use joulebus_lab::trial::{Column, Trial};
use serde::Serialize;

use crate::data_simulate;
use crate::exit::Outcome;
use crate::output::Output;

/// Look at recorded trials, and write simulated ones
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus data info recordings/*.csv.gz\n  \
    joulebus data simulate simulated")]
pub(crate) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    Info(InfoArgs),
    Simulate(data_simulate::Args),
}

/// Show rows, rate, gaps, held readings and missing columns of recorded trials
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus data info recordings/*.csv.gz\n  \
    joulebus data info a.npy --format json")]
struct InfoArgs {
    /// Trials (.npy, .csv, .csv.gz)
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
}

#[derive(Debug, Serialize)]
struct Report {
    trials: Vec<TrialReport>,
}

#[derive(Debug, Serialize)]
struct TrialReport {
    file: String,
    robot_name: Option<String>,
    rows: usize,
    duration_s: f64,
    rate_hz: f64,
    gaps: usize,
    longest_gap_s: Option<f64>,
    /// Rows whose time does not advance.
    not_advancing: usize,
    held_readings: usize,
    missing_readings: usize,
    mean_power_w: Option<f64>,
    least_power_w: Option<f64>,
    greatest_power_w: Option<f64>,
    missing_columns: Vec<&'static str>,
    ignored_columns: Vec<String>,
    no_final_line_break: bool,
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    match &args.what {
        What::Info(args) => info(args, output),
        What::Simulate(args) => data_simulate::run(args, output),
    }
}

fn info(args: &InfoArgs, output: Output) -> anyhow::Result<Outcome> {
    let trials = args
        .files
        .iter()
        .map(|file| Ok(report(&Trial::read(file)?)))
        .collect::<anyhow::Result<Vec<_>>>()?;
    output.report(&Report { trials })?;
    Ok(Outcome::Done)
}

fn report(trial: &Trial) -> TrialReport {
    let notes = trial.notes();
    let known = |values: &[f64]| -> Vec<f64> {
        values
            .iter()
            .copied()
            .filter(|value| !value.is_nan())
            .collect()
    };
    let power = trial.column(Column::Power).map(known).unwrap_or_default();
    let longest = notes.gaps.iter().map(|gap| gap.length_ns).max();
    let last_ns = trial.offset_ns().iter().max().copied().unwrap_or_default();
    TrialReport {
        file: trial.path().display().to_string(),
        robot_name: trial.robot_name().map(str::to_owned),
        rows: trial.rows(),
        duration_s: last_ns as f64 / 1e9,
        rate_hz: notes.rate_hz,
        gaps: notes.gaps.len(),
        longest_gap_s: longest.map(|length_ns| length_ns as f64 / 1e9),
        not_advancing: notes.not_advancing.len(),
        held_readings: notes.held_readings,
        missing_readings: notes.missing_readings,
        mean_power_w: (!power.is_empty()).then(|| power.iter().sum::<f64>() / power.len() as f64),
        least_power_w: power.iter().copied().reduce(f64::min),
        greatest_power_w: power.iter().copied().reduce(f64::max),
        missing_columns: notes
            .missing_columns
            .iter()
            .map(|column| column.name())
            .collect(),
        ignored_columns: notes.ignored_columns.clone(),
        no_final_line_break: notes.no_final_line_break,
    }
}

impl fmt::Display for Report {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for trial in &self.trials {
            write!(out, "{trial}")?;
        }
        Ok(())
    }
}

impl fmt::Display for TrialReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let robot = self.robot_name.as_deref().unwrap_or("no name");
        writeln!(out, "{} (robot {robot})", self.file)?;
        let (rows, rate, duration) = (self.rows, self.rate_hz, self.duration_s);
        writeln!(out, "  {rows} rows at {rate:.2} Hz, {duration:.1} s")?;
        if let (Some(mean), Some(least), Some(greatest)) =
            (self.mean_power_w, self.least_power_w, self.greatest_power_w)
        {
            writeln!(out, "  power {mean:.2} W, {least:.2} to {greatest:.2} W")?;
        }
        let (held, missing) = (self.held_readings, self.missing_readings);
        writeln!(out, "  readings held {held}, missing {missing}")?;
        if let Some(longest) = self.longest_gap_s {
            writeln!(out, "  {} gaps, the longest {longest:.3} s", self.gaps)?;
        }
        if self.not_advancing > 0 {
            writeln!(
                out,
                "  {} rows whose time does not advance",
                self.not_advancing
            )?;
        }
        if !self.missing_columns.is_empty() {
            writeln!(out, "  without {}", self.missing_columns.join(" "))?;
        }
        if !self.ignored_columns.is_empty() {
            writeln!(out, "  ignored {}", self.ignored_columns.join(" "))?;
        }
        if self.no_final_line_break {
            writeln!(
                out,
                "  the last line has no line break: it may have been cut off"
            )?;
        }
        Ok(())
    }
}
