//! `joulebus model compare`: two models on the same recordings.

use std::fmt;
use std::path::PathBuf;

use joulebus_eval::score::{Comparison, Verdict, compare};
use joulebus_program::exit::Outcome;
use joulebus_program::output::Output;
use serde::Serialize;

use crate::design::usage;
use crate::eval::{Selection, load, warn};
use crate::judgement::report;

/// Compare two models on the same recordings: by group, robot and trial, with paired intervals
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus model compare old.safetensors new.safetensors recordings/\n  \
    joulebus model compare old.safetensors new.safetensors recordings/ --split trial --fail-worse\n\n\
    Both are scored on the rows for which both have a forecast and that neither was trained on. \
    Differences are new less old. Skill is 1 - squared error of the new over that of the old. \
    Better or worse means that the whole confidence interval of the skill lies on one side of 0. \
    The intervals are of draws of whole trials. Fewer than 10 trials cannot tell. \
    Of twenty robots, one will do so by chance at 95 %.\n\n\
    Exits with 0 whichever is better. With --fail-worse, exits with 3 if the new one is worse on \
    all recordings of a platform together.")]
pub(super) struct Args {
    /// The current model
    #[arg(value_name = "OLD")]
    old: PathBuf,
    /// The candidate model
    #[arg(value_name = "NEW")]
    new: PathBuf,
    #[command(flatten)]
    asked: Selection,
    /// Exit with 3 if the new model is significantly worse
    #[arg(long)]
    fail_worse: bool,
}

/// One comparison per platform.
#[derive(Debug, Serialize)]
struct CompareReport {
    comparisons: Vec<Comparison>,
}

pub(super) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let models = [load(&args.old)?, load(&args.new)?];
    let config = args.asked.config()?;
    let options = args.asked.options();
    let mut comparisons = Vec::new();
    let sections = args.asked.sections(&config, true)?;
    let implausible = args.asked.judge(&sections)?;
    for section in sections {
        let design = args.asked.design(&section, &models)?;
        let subject = section.subject(&models, &design);
        let comparison = compare(subject, &options).map_err(usage)?;
        warn(&comparison.warnings);
        comparisons.push(comparison);
    }
    let worse = comparisons.iter().any(|one| one.all.verdict == Verdict::Worse);
    report(output, &CompareReport { comparisons }, implausible)?;
    Ok(Outcome::unless_lost(args.fail_worse && worse))
}

impl fmt::Display for CompareReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (at, comparison) in self.comparisons.iter().enumerate() {
            if at > 0 {
                writeln!(out, "\n")?;
            }
            write!(out, "{comparison}")?;
        }
        Ok(())
    }
}
