//! `replay --verify` and `replay --model`: recompute instead of playing.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use joulebus_capture_verify::{Comparison, Verdict, Verification, Verifier, WhatIf};
use joulebus_models::load_models;
use joulebus_predictor::Model;
use joulebus_program::exit::Outcome;
use joulebus_program::model_source;
use joulebus_program::output::Output;
use serde::Serialize;

use super::Args;
use super::files::Files;

/// A result with the fields common to all of them.
#[derive(Debug, Serialize)]
struct Computed<R> {
    files: String,
    fleet: String,
    #[serde(flatten)]
    result: R,
    /// Read errors.
    damages: Vec<String>,
    /// What the files have besides, which is not part of the result.
    left_out: Vec<String>,
    took_s: f64,
    /// Recorded time over computing time.
    times_real_time: f64,
}

pub(super) fn verify(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let files = Files::open(&args.files, args.fleet.as_deref())?;
    let config = files.config(args.config.as_ref())?;
    let models = load_models(&config)?;
    let tick_rules = files.tick_rules()?;
    files.check_order()?;
    let rules = files.answer_rules();
    let verifier = Verifier::new(config.settings().clone(), models)?;
    let mut verifier = verifier
        .with_answer_rules(rules)
        .with_tick_rules(tick_rules)
        .with_period_ns(config.tick_period_ns());
    let begun = Instant::now();
    let mut messages = files.read();
    for entry in args.span.of(&mut messages) {
        verifier.push(entry);
    }
    let mut result: Verification = verifier.finish();
    let mut damages = messages.damages;
    // Those that are not used prove nothing.
    damages.extend(files.altered().filter(|_| args.config.is_none()));
    if !damages.is_empty() && result.verdict != Verdict::Different {
        result.verdict = Verdict::Incomplete;
    }
    let (is_clean, recorded_s) = (result.is_clean(), result.recorded_s);
    let left_out = left_out(args, &files, &messages.of_others);
    let computed = computed(&files, result, (damages, left_out), begun, recorded_s);
    output.report(&computed)?;
    Ok(Outcome::unless_lost(!is_clean))
}

pub(super) fn compare(args: &Args, other: &Path, output: Output) -> anyhow::Result<Outcome> {
    let files = Files::open(&args.files, args.fleet.as_deref())?;
    let config = files.config(args.config.as_ref())?;
    let network = model_source::load(other)?;
    let settings = config.settings().clone();
    let others = vec![Model::Network(network); settings.platforms.len()];
    let mut what_if = WhatIf::new(settings, load_models(&config)?, others)?;
    let begun = Instant::now();
    let mut messages = files.read();
    let mut times = None;
    for entry in args.span.of(&mut messages) {
        let (first, _) = times.unwrap_or((entry.log_time_ns, 0));
        times = Some((first, entry.log_time_ns));
        what_if.push(entry);
    }
    let result: Comparison = what_if.finish();
    let (first, last) = times.unwrap_or_default();
    let lost = result.frames_missing > 0 || result.ticks == 0 || !messages.damages.is_empty();
    let recorded_s = last.saturating_sub(first) as f64 / 1e9;
    let read = (messages.damages, left_out(args, &files, &messages.of_others));
    let computed = computed(&files, result, read, begun, recorded_s);
    output.report(&computed)?;
    Ok(Outcome::unless_lost(lost))
}

/// Parts of the files that were not read, or are of other fleets.
fn left_out(args: &Args, files: &Files, of_others: &BTreeMap<Arc<str>, u64>) -> Vec<String> {
    let part = args.span.is_part().then(|| {
        "only the part that --start-offset and --playback-duration choose: of the rest, nothing is \
         known"
            .to_owned()
    });
    let others = of_others.iter().map(|(fleet, count)| {
        let remedy = if files.has(fleet) {
            format!("choose it with --fleet {fleet}")
        } else {
            "give its files alone".to_owned()
        };
        format!("{count} messages of fleet {fleet} are left out: {remedy}")
    });
    part.into_iter().chain(others).collect()
}

fn computed<R>(
    files: &Files,
    result: R,
    (damages, left_out): (Vec<String>, Vec<String>),
    begun: Instant,
    recorded_s: f64,
) -> Computed<R> {
    let took_s = begun.elapsed().as_secs_f64();
    Computed {
        files: files.name(),
        fleet: files.fleet.clone(),
        result,
        damages,
        left_out,
        took_s,
        times_real_time: recorded_s / took_s,
    }
}

impl<R: fmt::Display> fmt::Display for Computed<R> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}", self.result)?;
        for damage in self.left_out.iter().chain(&self.damages) {
            writeln!(out, "{damage}")?;
        }
        writeln!(
            out,
            "{} of fleet {}: {:.2} s, {:.0} times real time",
            self.files, self.fleet, self.took_s, self.times_real_time
        )
    }
}
