//! An evaluation in parts, each by a process of its own, and merging them.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::bail;
use joulebus_eval::score::score_portion;
use joulebus_eval::{EvalPart, PartError};
use joulebus_predictor::Model;
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::file;
use joulebus_program::output::{Output, log_line};
use serde::Serialize;

use super::subject::Section;
use super::{Args, usage, warn};

/// Maximum number of parts of an evaluation.
const MAX_PARTS: u32 = 100_000;
/// Maximum size of a part's file, bytes. It needs some 35 for each row of its recordings.
const MAX_BYTES: u64 = 8 << 30;

/// Evaluating in parts.
#[derive(Debug, clap::Args)]
pub(super) struct PartArguments {
    /// Evaluate part I of N, from 1: every N-th recording. Its sums are written with --out
    #[arg(long, value_name = "I/N", requires = "out")]
    partition: Option<Partition>,
    /// The part's file, which must not exist
    #[arg(short, long, value_name = "FILE", requires = "partition")]
    out: Option<PathBuf>,
    /// Merge the parts in these files (PATH…) into the report that a single run would give
    #[arg(long, conflicts_with_all = [
        "partition", "out", "model", "config", "platform", "first_robot", "map", "current", "accept", "split", "held_out", "leave_out", "seed",
        "fit", "forecasts", "horizons", "origins_every", "energy", "resamples", "confidence", "block_rows",
    ])]
    pub(super) merge: bool,
}

/// A part, and its file.
#[derive(Debug, Clone, Copy)]
pub(super) struct AskedPart<'a> {
    part: Partition,
    out: &'a Path,
}

impl PartArguments {
    pub(super) fn asked(&self) -> Option<AskedPart<'_>> {
        let out = self.out.as_deref()?;
        self.partition.map(|part| AskedPart { part, out })
    }
}

/// Part `number` of `of`, from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Partition {
    number: u32,
    of: u32,
}

impl FromStr for Partition {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = text.split_once('/').and_then(|(number, of)| {
            let (number, of) = (number.parse().ok()?, of.parse().ok()?);
            (1 <= number && number <= of && of <= MAX_PARTS).then_some(Self { number, of })
        });
        parsed.ok_or_else(|| {
            format!("allowed are I/N with whole numbers, I from 1 to N and N up to {MAX_PARTS}")
        })
    }
}

impl fmt::Display for Partition {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}/{}", self.number, self.of)
    }
}

/// The report of one part of an evaluation.
#[derive(Debug, Serialize)]
struct PartReport {
    /// The requested part, for instance 2/7.
    partition: String,
    /// Recordings evaluated here.
    recordings: usize,
    /// Recordings of all parts.
    of: usize,
    /// The part's file.
    file: String,
}

impl fmt::Display for PartReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { partition, recordings, of, file } = self;
        writeln!(
            out,
            "part {partition}: {recordings} of {of} recordings in {file}. With all parts: \
                joulebus eval --merge FILE…"
        )
    }
}

/// Evaluates one part.
pub(super) fn run(
    args: &Args,
    asked: &AskedPart<'_>,
    (sections, models): (&[Section], &[Model]),
    output: Output,
) -> anyhow::Result<Outcome> {
    let AskedPart { part, out } = *asked;
    // Checked before the work. A file of that name that appears during it belongs to a process with
    // the same part.
    if out.symlink_metadata().is_ok() {
        bail!("{} exists. Name a new file, or remove it", out.display());
    }
    let options = args.options()?;
    // Recordings are counted through all platforms, so that parts are of about the same size.
    let mut before = 0;
    let mut portions = Vec::new();
    for section in sections {
        let models = std::slice::from_ref(&models[section.place]);
        let design = args.asked.design(section, models)?;
        let is_own = |at: usize| (before + at) % part.of as usize == part.number as usize - 1;
        let portion = score_portion(section.subject(models, &design), &options, is_own);
        portions.push(portion.map_err(usage)?);
        before += section.len();
    }
    let counts = portions.iter().map(|portion| portion.recordings());
    let (recordings, of) = counts.fold((0, 0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
    let bytes = EvalPart::new(part.number, part.of, portions).to_bytes();
    file::write(out, &bytes)?;
    output.report(&PartReport {
        partition: part.to_string(),
        recordings,
        of,
        file: out.display().to_string(),
    })?;
    Ok(Outcome::Done)
}

/// Reports the merged parts.
pub(super) fn merge<'a>(
    files: impl Iterator<Item = &'a Path>,
    output: Output,
) -> anyhow::Result<Outcome> {
    let read = |path: &Path| -> anyhow::Result<_> {
        let name = path.display().to_string();
        let bytes = joulebus_files::read(path, MAX_BYTES);
        let bytes = bytes.map_err(|error| anyhow::anyhow!("{name}: {error}"))?;
        let part = EvalPart::from_bytes(&name, &bytes)?;
        Ok((name, part))
    };
    let parts = files.map(read).collect::<anyhow::Result<Vec<_>>>()?;
    let merged = EvalPart::merge(parts).map_err(|error| match error {
        error @ (PartError::Count { .. }
        | PartError::Twice { .. }
        | PartError::Missing { .. }
        | PartError::Different { .. }) => UsageError(error.to_string()).into(),
        error => anyhow::Error::from(error),
    })?;
    for evaluation in &merged.report.evaluations {
        warn(&evaluation.warnings);
    }
    for (platform, error) in &merged.refused {
        log_line(&format!("warning: platform {platform}: {error}"));
    }
    output.report(&merged.report)?;
    Ok(Outcome::Done)
}
