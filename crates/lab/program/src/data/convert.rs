//! `joulebus data convert`: converts recordings.

use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::ValueEnum;
use joulebus_dataset::trial::{Column, Form, Resample, Resampled, Table};
use joulebus_files::{WholeFolder, without_ending};
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::output::Output;
use serde::Serialize;

use crate::recordings::{LineArguments, Recordings, Resampling};

/// Convert recorded trials to another format, bit for bit, and resample on request
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus data convert trial1.npy --out trial1.csv.gz\n  \
    joulebus data convert runs/ --to npy --robot 7 --drop v_meas_mps,omega_meas_radps --out arrays/\n  \
    joulebus data convert husky/ --to csv.gz --resample hold --rate 30 --out husky-30hz/\n\n\
    A file of several robots is split into one file per robot. What the format cannot represent is refused, never \
    dropped: an array has eleven columns, and the robot as a number.\n\
    Resampling changes the data. hold: the latest row, as a controller would have read it. mean: \
    over the period that ends, which keeps the energy. linear: between the adjacent rows. Gaps \
    are kept, \
    and NaN stays NaN.\n\
    --whole-rows keeps what a power failure left of a file: the rows before its cut or empty end.\n\
    Exit codes: 3 if rows were left out because their time does not advance, or lines because they are no whole rows.")]
pub(super) struct Args {
    #[command(flatten)]
    recordings: Recordings,
    #[command(flatten)]
    lines: LineArguments,
    /// The output file or, with --to, the output directory
    #[arg(short, long, value_name = "PATH")]
    out: PathBuf,
    /// Format of the files in the directory
    #[arg(long, value_enum, value_name = "FORM")]
    to: Option<To>,
    /// Resampling method
    #[arg(long, value_enum, value_name = "METHOD", requires = "rate")]
    resample: Option<Resampling>,
    /// Rows per second of the new grid
    #[arg(long, value_name = "HZ", requires = "resample")]
    rate: Option<f64>,
    /// Columns to leave out, by their names
    #[arg(long, value_name = "NAME,…", value_delimiter = ',')]
    drop: Vec<String>,
    /// New name of the robot, such as a number for an array
    #[arg(long, value_name = "NAME")]
    robot: Option<String>,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum To {
    /// The published array, float64
    Npy,
    /// CSV with a header
    Csv,
    /// CSV compressed by gzip
    #[value(name = "csv.gz")]
    CsvGz,
}

#[derive(Debug, Serialize)]
struct ConvertReport {
    resample: Option<Resample>,
    files: Vec<Written>,
}

#[derive(Debug, Serialize)]
struct Written {
    from: PathBuf,
    file: PathBuf,
    robot_name: Option<String>,
    rows: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    resampled: Option<Resampled>,
    dropped_columns: Vec<String>,
    unnamed_rows: usize,
    /// Lines that are no whole rows.
    left_out_lines: usize,
    #[serde(skip)]
    left_out: String,
}

pub(super) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let resample = args.grid();
    let dropped = args.dropped()?;
    let found = args.recordings.find()?;
    let map = args.recordings.map().whole_rows(args.lines.whole_rows);
    let mut tables = Vec::new();
    for file in &found {
        tables.extend(Table::read_mapped(file, &map)?);
    }
    if resample.is_some() {
        // On a grid, recordings that were appended to each other do not overlap.
        tables = tables.into_iter().flat_map(Table::runs).collect();
    }
    let targets = args.targets(&tables)?;
    let whole = args.to.map(|_| WholeFolder::begin(&args.out)).transpose();
    let mut whole = whole.map_err(|error| {
        UsageError(format!("{} is not a directory: {error}", args.out.display()))
    })?;
    let failed = || format!("cannot write into {}", args.out.display());
    let mut files = Vec::with_capacity(tables.len());
    for (mut table, file) in tables.into_iter().zip(targets) {
        let from = table.path().to_owned();
        let dropped_columns = drop_columns(&mut table, &dropped, &args.drop)?;
        if let Some(name) = &args.robot {
            table.rename(name);
        }
        let unnamed_rows = table.unnamed_rows();
        let (left_out_lines, left_out) = (table.left_out().lines, table.left_out().to_string());
        let mut resampled = None;
        if let Some(how) = resample {
            let refused = || format!("{} cannot be resampled", from.display());
            let (made, counts) = table.resampled(how).with_context(refused)?;
            (table, resampled) = (made, Some(counts));
        }
        let path = match (&mut whole, file.file_name()) {
            (Some(whole), Some(name)) => whole.path(name).with_context(failed)?,
            _ => file.clone(),
        };
        table.write(&path).map_err(|error| error.at(&file))?;
        files.push(Written {
            from,
            file,
            robot_name: table.robot_name().map(str::to_owned),
            rows: table.rows(),
            resampled,
            dropped_columns,
            unnamed_rows,
            left_out_lines,
            left_out,
        });
    }
    if let Some(whole) = whole {
        whole.keep_new().with_context(failed)?;
    }
    let lost = |file: &Written| {
        let counts = file.resampled;
        file.left_out_lines > 0 || counts.is_some_and(|counts| counts.not_advancing > 0)
    };
    let lost = files.iter().any(lost);
    output.report(&ConvertReport { resample, files })?;
    Ok(Outcome::unless_lost(lost))
}

impl Args {
    fn grid(&self) -> Option<Resample> {
        let method = self.resample?.into();
        let rate_hz = self.rate?;
        Some(Resample { method, rate_hz })
    }

    /// The known columns to drop.
    fn dropped(&self) -> Result<Vec<Column>, UsageError> {
        if self.drop.iter().any(|name| name == Column::Power.name()) {
            let what = "power_mW cannot be dropped: a trial needs it";
            return Err(UsageError(what.to_owned()));
        }
        let known = Column::ALL.into_iter();
        Ok(known.filter(|column| self.drop.iter().any(|name| name == column.name())).collect())
    }

    /// The output file of each table.
    fn targets(&self, tables: &[Table]) -> Result<Vec<PathBuf>, UsageError> {
        let Some(to) = self.to else {
            if tables.len() != 1 {
                let (count, out) = (tables.len(), self.out.display());
                let what = format!("{count} trials cannot all be written to {out}");
                return Err(UsageError(format!(
                    "{what}. Give --to npy, csv or csv.gz, and a directory"
                )));
            }
            return Ok(vec![self.out.clone()]);
        };
        let targets: Vec<PathBuf> = tables
            .iter()
            .enumerate()
            .map(|(at, table)| {
                let of_file = |other: &&Table| other.path() == table.path();
                let of_robot = |other: &&Table| other.robot_name() == table.robot_name();
                let alone = tables.iter().filter(of_file).all(|other| of_robot(&other));
                let robot = table.robot_name().filter(|_| !alone);
                let before = tables[..at].iter().filter(of_file).filter(of_robot).count();
                self.out.join(file_name(table.path(), (robot, before + 1), to.into()))
            })
            .collect();
        match targets.iter().enumerate().find(|(at, file)| targets[..*at].contains(file)) {
            None => Ok(targets),
            Some((at, file)) => {
                let (from, file) = (tables[at].path().display(), file.display());
                let what =
                    format!("{from} and an earlier recording would both be written to {file}");
                Err(UsageError(format!("{what}. Convert them one by one")))
            }
        }
    }
}

/// The recording's name with another extension. It includes the robot's name if a file holds
/// several, and the number of its recordings but for the first.
fn file_name(path: &Path, (robot, run): (Option<&str>, usize), form: Form) -> String {
    let name = path.file_name().and_then(|name| name.to_str());
    let name = name.unwrap_or("recording");
    let stem = match Form::new(path) {
        Some(form) => without_ending(name, &form.ending()[1..]).unwrap_or(name),
        None => without_ending(name, "mcap").unwrap_or(name),
    };
    let run = if run > 1 { format!("_run_{run}") } else { String::new() };
    let ending = format!("{run}{}", form.ending());
    match robot {
        None => format!("{stem}{ending}"),
        Some(robot) => {
            let plain = |c: char| {
                if c.is_alphanumeric() || c == '-' || c == '.' { c } else { '_' }
            };
            let robot: String = robot.chars().map(plain).collect();
            format!("{stem}_robot_{robot}{ending}")
        }
    }
}

impl From<To> for Form {
    fn from(to: To) -> Self {
        match to {
            To::Npy => Self::Npy,
            To::Csv => Self::Csv,
            To::CsvGz => Self::CsvGz,
        }
    }
}

/// Drops columns, and refuses columns that would be lost without having been named. Returns the
/// names of those dropped.
fn drop_columns(
    table: &mut Table,
    known: &[Column],
    asked: &[String],
) -> Result<Vec<String>, UsageError> {
    let unnamed = table.ignored_columns().iter().find(|name| !asked.contains(name));
    if let Some(name) = unnamed {
        let file = table.path().display();
        let what = format!("{file}: the column {name:?} is unknown");
        return Err(UsageError(format!("{what}. Drop it with --drop {name}")));
    }
    let mut dropped = table.ignored_columns().to_vec();
    for column in known {
        if table.column(*column).is_some() {
            table.drop_column(*column);
            dropped.push(column.name().to_owned());
        }
    }
    Ok(dropped)
}

impl fmt::Display for ConvertReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for written in &self.files {
            let (from, file, rows) = (written.from.display(), written.file.display(), written.rows);
            writeln!(out, "{from} to {file}: {rows} rows")?;
            if let Some(counts) = &written.resampled {
                let Resampled { rows_before, not_advancing, in_gaps, .. } = counts;
                writeln!(
                    out,
                    "  resampled from {rows_before} rows; {in_gaps} times of the grid lie in gaps, \
                     {not_advancing} rows left out because their time does not advance"
                )?;
            }
            if !written.dropped_columns.is_empty() {
                writeln!(out, "  left out: {}", written.dropped_columns.join(" "))?;
            }
            if written.left_out_lines > 0 {
                writeln!(out, "  {}", written.left_out)?;
            }
            if written.unnamed_rows > 0 {
                let rows = written.unnamed_rows;
                writeln!(out, "  {rows} rows without a name got that of the robot")?;
            }
        }
        Ok(())
    }
}
