//! `joulebus data check`: faults of recordings.

use std::fmt;

use joulebus_dataset::inspect::{Check, Finding, Limits, check_files};
use joulebus_dataset::trial::ColumnMap;
use joulebus_program::config_file::ConfigFile;
use joulebus_program::exit::Outcome;
use joulebus_program::output::Output;
use serde::Serialize;

use crate::judgement::{AcceptArguments, limits};
use crate::recordings::Recordings;
use joulebus_plausibility::Card;
use joulebus_program::platform::platform;

/// Find faults in recorded trials, with file and row
#[derive(Debug, clap::Args)]
#[command(after_help = format!("Examples:\n  \
    joulebus data check recordings/\n  \
    joulebus data check 'runs/**/*.npy' --platform gternal\n  \
    joulebus data check logs/ --map time=stamp_ms,power_W=load\n  \
    joulebus data check recordings/ --format json\n\n\
    Faults: files that are not recordings, duplicates, times that repeat or go back, gaps, missing \
    readings and values, readings held too long, truncated files, and the findings below. --accept \
    makes one of them a note. Held readings, and columns that are missing, unknown or constant are \
    reported, but are not faults.\n\
    Exit codes: 0 without faults, 3 with faults.\n\n\
    Findings, each with what to check. The option that mends a recording is in the fault:\n{}\n\
    Names of columns in a CSV, upper or lower case. --map names others. Time and power are required, or \
    voltage and current instead of power:\n{}", cards(), joulebus_dataset::trial::column_names()))]
pub(super) struct Args {
    #[command(flatten)]
    recordings: Recordings,
    #[command(flatten)]
    accept: AcceptArguments,
    /// Platform of the config whose limits of power and velocity apply, instead of those of any
    /// wheeled robot
    #[arg(long, value_name = "NAME")]
    platform: Option<String>,
    #[command(flatten)]
    config: ConfigFile,
}

/// Occurrences of a finding in JSON, and in text.
const PLACES: usize = 10;
const SHOWN_PLACES: usize = 3;

#[derive(Debug, Serialize)]
struct CheckReport {
    sound: bool,
    #[serde(flatten)]
    check: Check,
    limits: Limits,
}

pub(super) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let files = args.recordings.find()?;
    let (limits, map, accept) = args.of_platform()?;
    let mut check = check_files(&files, &map, &limits, PLACES);
    check.accept(&accept.accept);
    let sound = check.is_sound();
    output.report(&CheckReport { sound, check, limits })?;
    Ok(Outcome::unless_lost(!sound))
}

impl Args {
    /// The limits that apply, and how recordings are read.
    fn of_platform(&self) -> anyhow::Result<(Limits, ColumnMap, AcceptArguments)> {
        let Some(name) = &self.platform else {
            let map = self.recordings.map();
            return Ok((Limits::default(), map, self.accept.clone()));
        };
        let config = self.config.load()?;
        let settings = config.settings();
        let own = platform(settings, name)?;
        let place = settings.platforms.iter().position(|one| one == own);
        // `platform` has found it among them, so there is an index.
        let place = place.unwrap_or_default();
        let map = self.recordings.map_of(&config, place)?;
        let accept = self.accept.or_configured(&config, [place])?;
        Ok((limits(own), map, accept))
    }
}

impl fmt::Display for CheckReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Check { files, trials, robots, rows, faults, findings } = &self.check;
        for finding in findings.iter().filter(|finding| finding.fault) {
            write_finding(out, "fault", finding)?;
        }
        for finding in findings.iter().filter(|finding| !finding.fault) {
            let word = if finding.accepted { "accepted" } else { "note" };
            write_finding(out, word, finding)?;
        }
        writeln!(
            out,
            "{files} files, {trials} trials of {robots} robots, {rows} rows: {}",
            match faults {
                0 => "no fault".to_owned(),
                1 => "1 fault".to_owned(),
                many => format!("{many} faults"),
            }
        )
    }
}

/// The cards of findings, a line each.
fn cards() -> String {
    let line = |card: &Card| format!("  {:10} {}: {}\n", card.name, card.means, card.check);
    Card::all().iter().map(line).collect()
}

fn write_finding(out: &mut fmt::Formatter<'_>, word: &str, finding: &Finding) -> fmt::Result {
    let Finding { kind, count, files, .. } = finding;
    writeln!(out, "{word}: {kind}: {count} in {files} files")?;
    for place in finding.places.iter().take(SHOWN_PLACES) {
        writeln!(out, "  {place}")?;
    }
    Ok(())
}
