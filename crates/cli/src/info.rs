//! `joulebus info` and `joulebus doctor FILE`: contents of captures. Other MCAP files are refused by
//! name, with the program that reads them.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use joulebus_capture_format::inspect::{Finding, Inspection, inspect};
use joulebus_program::exit::Outcome;
use joulebus_program::output::Output;
use serde::Serialize;

/// Show the contents of captures: counts, rates, gaps, clocks, schemas, attachments
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus info run.mcap\n  \
    joulebus info run*.mcap --format json\n\n\
    Reads corrupt captures as far as possible, in bounded memory for any length. \
    `joulebus doctor FILE` reports all errors of a file. MCAP files of other programs are refused: \
    `mcap info`, `mcap doctor` and Foxglove read them.\n\
    Exit codes: 3 if a file is corrupt or inconsistent.")]
pub(crate) struct Args {
    /// Captures
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
}

#[derive(Debug, Serialize)]
pub(crate) struct FileReport {
    file: String,
    /// Metadata of a file written by this program.
    #[serde(skip_serializing_if = "Option::is_none")]
    joulebus: Option<BTreeMap<String, String>>,
    #[serde(flatten)]
    pub(crate) found: Inspection,
}

#[derive(Debug, Serialize)]
struct InfoReport {
    files: Vec<FileReport>,
}

pub(crate) fn look(path: &Path) -> anyhow::Result<FileReport> {
    let named = || path.display().to_string();
    let file = joulebus_files::open(path).with_context(named)?;
    let found = inspect(file).with_context(named)?;
    let joulebus = found
        .metadata
        .iter()
        .find(|metadata| metadata.name == "joulebus")
        .map(|metadata| metadata.entries.clone());
    if joulebus.is_none() && is_of_others(&found) {
        let (file, library) = (named(), &found.library);
        bail!(
            "{file}: an MCAP file of {library:?}, and no capture of joulebus. `mcap info {file}`, \
             `mcap doctor {file}` and Foxglove read it. `joulebus import` reads bags of ROS 2"
        );
    }
    Ok(FileReport { file: named(), joulebus, found })
}

/// True if another program has written the file. One that lost its beginning may be a capture.
fn is_of_others(found: &Inspection) -> bool {
    let has_topic = found.channels.iter().any(|channel| channel.topic.starts_with("joulebus/"));
    let is_known = found.complete || !found.library.is_empty();
    is_known && !has_topic && !found.library.starts_with("joulebus")
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let files = args.files.iter().map(|path| look(path)).collect::<anyhow::Result<Vec<_>>>()?;
    let report = InfoReport { files };
    output.report(&report)?;
    let is_sound = report.files.iter().all(|file| file.found.is_sound());
    Ok(Outcome::unless_lost(!is_sound))
}

impl fmt::Display for FileReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(out, "file         {}", self.file)?;
        for (key, value) in self.joulebus.iter().flatten() {
            writeln!(out, "  {key:<18} {value}")?;
        }
        write!(out, "{}", self.found)
    }
}

impl fmt::Display for InfoReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (number, file) in self.files.iter().enumerate() {
            if number > 0 {
                writeln!(out)?;
            }
            write!(out, "{file}")?;
            for finding in file.found.findings.iter().take(5) {
                writeln!(out, "  {finding}")?;
            }
            if file.found.findings.len() > 5 {
                writeln!(out, "  … all of them: joulebus doctor {}", file.file)?;
            }
        }
        Ok(())
    }
}

/// Errors of files, for `doctor`.
#[derive(Debug, Serialize)]
pub(crate) struct Diagnosis {
    files: Vec<Checked>,
}

#[derive(Debug, Serialize)]
struct Checked {
    file: String,
    sound: bool,
    complete: bool,
    errors: u64,
    notes: u64,
    messages: u64,
    bytes: u64,
    findings: Vec<Finding>,
}

/// `joulebus doctor FILE…`.
pub(crate) fn diagnose(files: &[PathBuf], output: Output) -> anyhow::Result<Outcome> {
    let files = files
        .iter()
        .map(|path| look(path).map(Checked::from))
        .collect::<anyhow::Result<Vec<_>>>()?;
    let diagnosis = Diagnosis { files };
    output.report(&diagnosis)?;
    Ok(Outcome::unless_lost(diagnosis.files.iter().any(|file| !file.sound)))
}

impl From<FileReport> for Checked {
    fn from(report: FileReport) -> Self {
        let FileReport { file, found, .. } = report;
        Self {
            file,
            sound: found.is_sound(),
            complete: found.complete,
            errors: found.errors,
            notes: found.notes,
            messages: found.messages,
            bytes: found.bytes,
            findings: found.findings,
        }
    }
}

impl fmt::Display for Diagnosis {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for file in &self.files {
            let state = match (file.sound, file.complete) {
                (true, true) => "ok  ",
                _ => "FAIL",
            };
            let (name, messages, bytes) = (&file.file, file.messages, file.bytes);
            writeln!(out, "{state}  {name}: {messages} messages in {bytes} bytes")?;
            for finding in &file.findings {
                writeln!(out, "      {finding}")?;
            }
            let more = file.errors + file.notes - file.findings.len() as u64;
            if more > 0 {
                writeln!(out, "      … and {more} more")?;
            }
            if !file.sound {
                writeln!(out, "      → joulebus recover {name} -o whole.mcap")?;
            }
        }
        Ok(())
    }
}
