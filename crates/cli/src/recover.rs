//! `joulebus recover`: rewrites a damaged file as a complete one.

use std::fmt;
use std::fs::File;
use std::io::Seek as _;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context as _;
use joulebus_capture_format::inspect::inspect;
use joulebus_capture_format::recover::{RecoverError, Recovery, recover};
use joulebus_program::exit::Outcome;
use joulebus_program::output::Output;
use serde::Serialize;

/// Rewrite a truncated or damaged MCAP file as a complete one, and report what is lost
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus recover killed.mcap -o whole.mcap\n  \
    joulebus recover damaged.mcap -o whole.mcap --format json\n\n\
    Everything readable is rewritten with new indexes and checksums. The result is opened again \
    and checked. Messages of a chunk whose checksum is wrong are kept and counted as \
    suspect.\n\
    Exit codes: 3 if something was lost, is suspect, or cannot be determined.")]
pub(crate) struct Args {
    /// The damaged file, which is not changed
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// The result, which must not exist
    #[arg(short, long, value_name = "OUT")]
    out: PathBuf,
}

#[derive(Debug, Serialize)]
struct RecoverReport {
    input: String,
    output: String,
    input_bytes: u64,
    output_bytes: u64,
    duration_s: f64,
    /// Read rate of the damaged file without the check of the result, MB/s.
    rate_mb_s: f64,
    #[serde(flatten)]
    recovery: Recovery,
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let input =
        joulebus_files::open(&args.input).with_context(|| args.input.display().to_string())?;
    let input_bytes = input.metadata()?.len();
    let started = Instant::now();
    let Written { recovery, duration_s, output_bytes } = write(input, args, started)?;
    let is_whole = recovery.is_lossless();
    output.report(&RecoverReport {
        input: args.input.display().to_string(),
        output: args.out.display().to_string(),
        input_bytes,
        output_bytes,
        duration_s,
        rate_mb_s: input_bytes as f64 / 1e6 / duration_s.max(1e-9),
        recovery,
    })?;
    Ok(Outcome::unless_lost(!is_whole))
}

struct Written {
    recovery: Recovery,
    /// Time until it was written, without its check.
    duration_s: f64,
    output_bytes: u64,
}

/// Writes and checks the result, which has no name before both are done.
fn write(input: File, args: &Args, started: Instant) -> anyhow::Result<Written> {
    let written = joulebus_files::create(&args.out, |result| {
        let (recovery, result) = recover(input, result)?;
        result.sync_all()?;
        let duration_s = started.elapsed().as_secs_f64();
        check(result, &recovery).map_err(|reason| RecoverError::Write { reason })?;
        Ok(Written { recovery, duration_s, output_bytes: result.metadata()?.len() })
    });
    written.map_err(|error| {
        let file = match &error {
            RecoverError::Read(_) => &args.input,
            _ => &args.out,
        };
        anyhow::Error::from(error).context(file.display().to_string())
    })
}

/// Reads the result again: it must be complete and contain what was counted. Otherwise the reason.
fn check(mut result: &File, recovery: &Recovery) -> Result<(), String> {
    result.rewind().map_err(|error| error.to_string())?;
    let found = inspect(result).map_err(|error| error.to_string())?;
    let (wanted, messages) = (recovery.messages.recovered, found.messages);
    if found.is_sound() && found.complete && messages == wanted {
        return Ok(());
    }
    let findings: Vec<String> = found.findings.iter().map(ToString::to_string).collect();
    let findings = findings.join(", ");
    Err(format!("the result is wrong: {messages} of {wanted} messages. {findings}"))
}

impl fmt::Display for RecoverReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}", self.recovery)?;
        let megabytes = self.input_bytes as f64 / 1e6;
        writeln!(
            out,
            "{} → {}: {megabytes:.1} MB in {:.2} s ({:.0} MB/s). The result was opened and checked",
            self.input, self.output, self.duration_s, self.rate_mb_s
        )
    }
}
