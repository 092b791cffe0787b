//! `joulebus analyze`: analysis of a dataset before training.

use std::fmt;
use std::path::{Path, PathBuf};

use joulebus_dataset::split::Split;
use joulebus_dataset::trial::Resample;
use joulebus_eval::analyze::{
    Ablation, Analysis, AnalysisSettings, AnalyzeError, Member, Series, analyze,
};
use joulebus_predictor::Model;
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::model_source;
use joulebus_program::output::Output;
use serde::Serialize;

use crate::judgement::{AcceptArguments, report};
use crate::recordings::{Recordings, Resampling, open};
use crate::split_unit::SplitUnit;

/// Analyse a dataset: autocorrelation, the gain of each input, and the share of a score that comes
/// from held readings
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus analyze recordings/\n  \
    joulebus analyze husky/ --split group --leave-out ICE\n  \
    joulebus analyze trials/*.npy --model gternal.safetensors --lags 30\n  \
    joulebus analyze recordings/ --format json\n\n\
    The held series is what a controller at 30 Hz reads, whatever the sensor's own rate. \
    Linear models are fitted by least squares on the training rows of the split, and all models are scored on \
    the same held-out rows. A held reading equals the one before to the bit. A constant load \
    below the sensor's resolution looks the same.")]
pub(crate) struct Args {
    #[command(flatten)]
    recordings: Recordings,
    #[command(flatten)]
    accept: AcceptArguments,
    /// Lags of the autocorrelation, 1 to 10,000
    #[arg(long, value_name = "N", default_value_t = 10)]
    lags: usize,
    /// A fixed grid, in addition to the native series
    #[arg(
        long,
        value_enum,
        value_name = "METHOD,…",
        value_delimiter = ',',
        default_value = "hold"
    )]
    resample: Vec<Resampling>,
    /// Rows per second of the grid
    #[arg(long, value_name = "HZ", default_value_t = 30.0)]
    rate: f64,
    /// Unit that stays together when rows are held out
    #[arg(long, value_enum, value_name = "BY", default_value_t = SplitUnit::Trial)]
    split: SplitUnit,
    /// Share held out
    #[arg(long, value_name = "SHARE", default_value_t = 0.3)]
    held_out: f64,
    /// Trials, robots or groups to hold out by name, instead of a share
    #[arg(long, value_name = "NAME,…", value_delimiter = ',')]
    leave_out: Vec<String>,
    /// Seed of the split
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Models to score as well (scores of one that was trained on the held-out rows are
    /// meaningless)
    #[arg(long, value_name = "FILE", num_args = 1)]
    model: Vec<PathBuf>,
}

#[derive(Debug, Serialize)]
struct AnalyzeReport(Analysis);

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let models = args.models()?;
    let recordings = open(args.recordings.find()?, &args.recordings.map())?;
    let implausible = args.accept.recordings(&recordings)?;
    let analysis = analyze(&recordings, &args.settings(), &models);
    let analysis = analysis.map_err(|error| match error {
        AnalyzeError::Trial(error) => anyhow::Error::from(error),
        error => UsageError(error.to_string()).into(),
    })?;
    report(output, &AnalyzeReport(analysis), implausible)?;
    Ok(Outcome::Done)
}

impl Args {
    fn settings(&self) -> AnalysisSettings {
        AnalysisSettings {
            lags: self.lags,
            grids: self.resample.iter().map(|how| self.grid(*how)).collect(),
            split: Split {
                by: self.split.into(),
                held_out: self.held_out,
                seed: self.seed,
                ..Split::default()
            },
            leave_out: self.leave_out.clone(),
            ..AnalysisSettings::default()
        }
    }

    fn grid(&self, how: Resampling) -> Resample {
        Resample { method: how.into(), rate_hz: self.rate }
    }

    fn models(&self) -> anyhow::Result<Vec<(String, Model)>> {
        self.model.iter().map(|path| model(path)).collect()
    }
}

fn model(path: &Path) -> anyhow::Result<(String, Model)> {
    let network = model_source::load(path)?;
    let name = format!("network {}", network.card().name);
    Ok((name, Model::Network(network)))
}

impl fmt::Display for AnalyzeReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Analysis { trials, robots, groups, series, .. } = &self.0;
        writeln!(out, "{trials} trials of {} robots in {} groups", robots.len(), groups.len())?;
        for series in series {
            write_series(out, series)?;
        }
        Ok(())
    }
}

fn write_series(out: &mut fmt::Formatter<'_>, series: &Series) -> fmt::Result {
    let (name, rows, held) = (&series.name, series.rows, 100.0 * series.held_share);
    writeln!(out, "\n{name}: {rows} rows, {held:.1} % of the readings repeat the one before")?;
    let lags = |values: &[Option<f64>]| -> String {
        let shown = values.iter().map(|value| match value {
            Some(value) => format!("{value:.3}"),
            None => "–".to_owned(),
        });
        shown.collect::<Vec<_>>().join(" ")
    };
    let count = series.pooled_autocorrelation.len();
    writeln!(
        out,
        "  autocorrelation at lags 1 to {count}\n    all trials pooled   {}\n    mean of the trials   {}",
        lags(&series.pooled_autocorrelation),
        lags(&series.mean_autocorrelation)
    )?;
    writeln!(out, "  split {}", series.split.name)?;
    if let Some(ablation) = &series.ablation {
        write_ablation(out, ablation)?;
    }
    for left_out in &series.left_out {
        writeln!(out, "  left out: {left_out}")?;
    }
    Ok(())
}

fn write_ablation(out: &mut fmt::Formatter<'_>, ablation: &Ablation) -> fmt::Result {
    let Ablation {
        fitted_rows,
        rows,
        held_rows,
        unusable_rows,
        power_mean_w,
        power_std_w,
        members,
    } = ablation;
    writeln!(
        out,
        "  fitted on {fitted_rows} rows, scored on {rows} ({held_rows} held), mean \
         {power_mean_w:.3} W, std {power_std_w:.3} W; without a velocity {unusable_rows}"
    )?;
    writeln!(
        out,
        "  {:26}{:>9}{:>10}{:>14}{:>14}{:>12}",
        "", "R²", "MAE, W", "R² on new", "MAE on new, W", "from held"
    )?;
    for member in members {
        let Member { name, all, new, held_share_of_gain, .. } = member;
        let share = match 100.0 * held_share_of_gain {
            share if share.is_finite() => format!("{share:.0} %"),
            _ => "–".to_owned(),
        };
        writeln!(
            out,
            "  {name:26}{:>9.4}{:>10.4}{:>14.4}{:>14.4}{share:>12}",
            all.r2, all.mae_w, new.r2, new.mae_w
        )?;
    }
    write_plainly(out, ablation)
}

/// One sentence on the share of the score that comes from held readings.
fn write_plainly(out: &mut fmt::Formatter<'_>, ablation: &Ablation) -> fmt::Result {
    let persistence = ablation.members.iter().find(|member| member.name == "persistence");
    let Some(Member { all, new, held_share_of_gain, .. }) = persistence else {
        return Ok(());
    };
    let held = 100.0 * ablation.held_rows as f64 / ablation.rows as f64;
    writeln!(
        out,
        "  {held:.1} % of these readings repeat the one before, where repeating the last reading \
         cannot fail."
    )?;
    if held_share_of_gain.is_finite() && ablation.held_rows > 0 {
        let share = 100.0 * held_share_of_gain;
        writeln!(
            out,
            "  Of what persistence saves of the squared error, {share:.0} % is saved on them: its \
             R² of {:.3} is {:.3} on new readings.",
            all.r2, new.r2
        )?;
    }
    Ok(())
}
