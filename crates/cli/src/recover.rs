//! `joulebus recover`: rewrites a damaged file as a complete one.

use std::fmt;
use std::fs::{self, File};
use std::io::Seek as _;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context as _, bail};
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
    let (recovery, duration_s) = write(input, args, started)?;
    let is_whole = recovery.is_lossless();
    output.report(&RecoverReport {
        input: args.input.display().to_string(),
        output: args.out.display().to_string(),
        input_bytes,
        output_bytes: fs::metadata(&args.out)?.len(),
        duration_s,
        rate_mb_s: input_bytes as f64 / 1e6 / duration_s.max(1e-9),
        recovery,
    })?;
    Ok(Outcome::unless_lost(!is_whole))
}

/// Writes and checks the result, which has no name before both are done. Returns the time of the
/// first, too.
fn write(input: File, args: &Args, started: Instant) -> anyhow::Result<(Recovery, f64)> {
    joulebus_files::create::<_, anyhow::Error>(&args.out, |result| {
        let (recovery, result) = recover(input, result).map_err(|error| {
            let is_input = matches!(error, RecoverError::Read(_));
            let file = if is_input { &args.input } else { &args.out };
            anyhow::Error::from(error).context(file.display().to_string())
        })?;
        result.sync_all()?;
        let duration_s = started.elapsed().as_secs_f64();
        check(result, &recovery)?;
        Ok((recovery, duration_s))
    })
    .with_context(|| format!("cannot write {}", args.out.display()))
}

/// Reads the result again: it must be complete and contain what was counted.
fn check(mut result: &File, recovery: &Recovery) -> anyhow::Result<()> {
    result.rewind()?;
    let found = inspect(result.try_clone()?).context("the result cannot be read again")?;
    let (wanted, messages) = (recovery.messages.recovered, found.messages);
    if !found.is_sound() || !found.complete || messages != wanted {
        let findings: Vec<String> = found.findings.iter().map(ToString::to_string).collect();
        let findings = findings.join(", ");
        bail!("the result is wrong: {messages} of {wanted} messages. {findings}");
    }
    Ok(())
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
