//! `joulebus export`: recordings and captures as a folder of Parquet files.

mod archive;
mod arguments;
mod partition;

use std::fmt;
use std::path::Path;

use anyhow::Context as _;
use joulebus_dataset::archive::is_listing;
use joulebus_dataset::inspect::{Implausible, Limits, is_short, judge};
use joulebus_dataset::trial::{ColumnMap, Table, Trial, TrialError, each_run, is_capture};
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::output::{Output, log_line};
use serde::Serialize;

use crate::judgement;
use crate::recordings::find_recordings;
use archive::{Adding, Archive};
pub(crate) use arguments::Args;
use partition::{Levels, Partition};

/// Rows by which it is seen whether a recording names its robots.
const FIRST_ROWS: usize = 256;

/// The report of an export.
#[derive(Debug, Serialize)]
struct ExportReport {
    /// The archive.
    folder: String,
    /// Recordings that were in it before.
    recordings_before: usize,
    /// Recordings added.
    recordings: usize,
    /// Their trials.
    trials: usize,
    /// Their rows.
    rows: u64,
    /// Bytes of their files.
    bytes: u64,
    /// Lines that are no whole rows.
    left_out_lines: usize,
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let [format, folder] = args.to.as_slice() else {
        return Err(UsageError("--to takes a format and a folder".to_owned()).into());
    };
    if format != "parquet" {
        let format = format.display();
        return Err(UsageError(format!("--to {format}: allowed is parquet")).into());
    }
    let folder = Path::new(folder);
    let map = args.columns.map();
    let files = find_recordings(&args.paths)?;
    let names = files.iter().map(|file| name(file));
    let names = names.collect::<Result<Vec<_>, _>>()?;
    let mut archive = Archive::open(folder, args.mixed)?;
    if let Some(name) = names.iter().find(|name| archive.has(name)) {
        let folder = folder.display();
        return Err(UsageError(format!(
            "{name} is in {folder} already. Name other recordings, or another folder"
        ))
        .into());
    }
    let mut report = ExportReport {
        folder: folder.display().to_string(),
        recordings_before: archive.len(),
        recordings: 0,
        trials: 0,
        rows: 0,
        bytes: 0,
        left_out_lines: 0,
    };
    // Before anything is written.
    let mut fits = files.iter().zip(&names).filter_map(|(file, name)| {
        let levels = levels(file, &map)?;
        archive.levels(name, levels).err()
    });
    if let Some(error) = fits.next() {
        archive.undo();
        return Err(error);
    }
    let mut found = Found::default();
    if report.recordings_before > 0 {
        let (before, folder) = (report.recordings_before, &report.folder);
        log_line(&format!("adding to the {before} recordings in {folder}"));
    }
    for (file, name) in files.iter().zip(names) {
        let mut adding = archive.add(name);
        let added = one(file, &map, &mut adding, (&mut report, &mut found));
        let added = added.and_then(|()| adding.finish());
        match added {
            Ok(trials) => report.trials += trials,
            Err(error) => {
                archive.undo();
                return Err(error);
            }
        }
        report.recordings += 1;
    }
    judgement::report(output, &report, judgement::warned(found.implausible, &found.short))?;
    Ok(Outcome::unless_lost(report.left_out_lines > 0))
}

/// Levels that a recording's first rows have for the folders of an archive. `None` if it cannot be
/// read, which the export reports.
fn levels(file: &Path, map: &ColumnMap) -> Option<Levels> {
    if is_capture(file) {
        return Some(Levels::ALL);
    }
    let mut first = None;
    // None: no further table is wanted.
    let read: Result<(), Option<TrialError>> =
        Table::each(file, &map.clone().in_parts_of(FIRST_ROWS), |table| {
            first = Some(Partition::new(None, None, table.robot_name()).levels());
            Err(None)
        });
    first.filter(|_| matches!(read, Err(None)))
}

/// Findings, and trials still to be judged.
#[derive(Default)]
struct Found {
    implausible: Vec<Vec<Implausible>>,
    /// Short trials, which are judged together.
    short: Vec<Trial>,
}

/// Adds the trials of a recording.
fn one(
    file: &Path,
    map: &ColumnMap,
    adding: &mut Adding<'_>,
    (report, found): (&mut ExportReport, &mut Found),
) -> anyhow::Result<()> {
    let mut left_out_lines = 0;
    // The archive has what was recorded, also where it is implausible.
    let mut judge = |table: Table| {
        if let Ok(trial) = table.into_trial() {
            found.implausible.push(judge(&trial, &Limits::default()));
            found.short.extend(Some(trial).filter(is_short));
        }
    };
    let mut add = |(rows, bytes): (u64, u64)| {
        report.rows += rows;
        report.bytes += bytes;
    };
    if is_capture(file) {
        return each_run(file, |mut run| -> anyhow::Result<()> {
            map.apply_sign(&mut run.table);
            let fleet = Some(run.fleet.as_str());
            add(adding.trial(fleet, &run.table, Some(&run.stamps))?);
            judge(run.table);
            Ok(())
        });
    }
    Table::each(file, map, |table| -> anyhow::Result<()> {
        let left_out = table.left_out();
        if !left_out.is_none() {
            log_line(&format!("warning: {}: {left_out}", file.display()));
            left_out_lines += left_out.lines;
        }
        add(adding.trial(None, &table, None)?);
        judge(table);
        Ok(())
    })?;
    report.left_out_lines += left_out_lines;
    Ok(())
}

/// The name of a recording: its path as it was given.
fn name(file: &Path) -> anyhow::Result<&str> {
    let is_parquet = joulebus_files::ends_in(file, "parquet");
    if is_listing(file) || is_parquet {
        let file = file.display();
        let what = format!("{file} is of an archive. Copy the folder, or name recordings");
        return Err(UsageError(what).into());
    }
    file.to_str().with_context(|| format!("{}: its name is no UTF-8. Rename it", file.display()))
}

impl fmt::Display for ExportReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { folder, recordings_before, recordings, trials, rows, bytes, left_out_lines } =
            self;
        let all = recordings_before + recordings;
        writeln!(
            out,
            "{recordings} recordings, {trials} trials, {rows} rows in {bytes} bytes: {folder} has {all} recordings"
        )?;
        match left_out_lines {
            0 => Ok(()),
            lines => writeln!(out, "{lines} lines that are no whole rows were left out"),
        }
    }
}
