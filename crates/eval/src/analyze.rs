//! Analysis of a dataset before training (arXiv 2603.13908, section 4): autocorrelation of
//! readings, the gain of each kind of input, and the share of a score that comes from held
//! readings.

mod ablation;
mod autocorrelation;

use std::path::Path;

use joulebus_predictor::{LAGS, Model};
use rayon::iter::{IntoParallelRefIterator as _, ParallelIterator as _};
use serde::{Deserialize, Serialize};

use joulebus_dataset::rows::trial_rows;
use joulebus_dataset::split::{
    Assignment, Source, Split, SplitError, SplitSummary, assign, assign_leaving_out, group_of,
};
use joulebus_dataset::trial::{Method, Resample, ResampleError, Trial};

pub use ablation::{Ablation, Member, Part};
pub use autocorrelation::{Autocorrelation, autocorrelation, pooled};

/// What to analyse.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AnalysisSettings {
    /// Lags of the autocorrelation, 1 or more, rows.
    pub lags: usize,
    /// Readings available to the forecasts, 1 to 5.
    pub window: usize,
    /// Grids in addition to the native series: the dataset at fixed rates.
    pub grids: Vec<Resample>,
    /// The split into fitted and held-out rows. The validation part is fitted on, because least
    /// squares needs no early stopping.
    pub split: Split,
    /// Units to hold out by name, instead of the split's share.
    pub leave_out: Vec<String>,
}

impl Default for AnalysisSettings {
    /// Ten lags, five readings, held at 30 Hz, 30 % of the trials held out.
    fn default() -> Self {
        Self {
            lags: 10,
            window: LAGS,
            grids: vec![Resample {
                method: Method::Hold,
                rate_hz: 30.0,
            }],
            split: Split {
                held_out: 0.3,
                ..Split::default()
            },
            leave_out: Vec::new(),
        }
    }
}

/// Why a dataset could not be analysed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AnalyzeError {
    /// No trial.
    #[error("found no trial to analyse; name one or more files")]
    NoTrial,
    /// A number is out of range.
    #[error("{what} = {found}; allowed: {allowed}")]
    Setting {
        /// Name of the setting.
        what: &'static str,
        /// Its value.
        found: usize,
        /// Allowed values.
        allowed: &'static str,
    },
    /// The data cannot be split as configured.
    #[error(transparent)]
    Split(#[from] SplitError),
    /// The data cannot be resampled as configured.
    #[error(transparent)]
    Resample(#[from] ResampleError),
}

/// Result of the analysis. Shares are from 0 to 1, power is in W.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Analysis {
    /// Trials.
    pub trials: usize,
    /// Distinct names of the robots.
    pub robots: Vec<String>,
    /// Distinct names of the groups.
    pub groups: Vec<String>,
    /// The native series, and one per configured grid.
    pub series: Vec<Series>,
    /// The settings.
    pub settings: AnalysisSettings,
}

/// The dataset on one grid.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Series {
    /// `native`, or `held at 30 Hz`.
    pub name: String,
    /// The grid; `None` for the native series.
    pub grid: Option<Resample>,
    /// Rows of all trials.
    pub rows: usize,
    /// Readings of all trials.
    pub readings: usize,
    /// Share of the readings equal to the previous one to the bit.
    pub held_share: f64,
    /// Mean over the trials at lag 1, 2, …, trials weighted equally.
    pub mean_autocorrelation: Vec<Option<f64>>,
    /// Over all trials at once ([`pooled`]), at lag 1, 2, …
    pub pooled_autocorrelation: Vec<Option<f64>>,
    /// Per trial.
    pub autocorrelations: Vec<TrialAutocorrelation>,
    /// The gain of each kind of input; `None`, with the reason in `left_out`, if it could not be
    /// computed.
    pub ablation: Option<Ablation>,
    /// The split.
    pub split: SplitSummary,
    /// Trials and inputs left out, with reasons.
    pub left_out: Vec<String>,
}

/// A trial's autocorrelation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrialAutocorrelation {
    /// Its file.
    pub trial: String,
    /// Its robot.
    pub robot: String,
    /// Its group.
    pub group: String,
    /// At lag 1, 2, …
    #[serde(flatten)]
    pub found: Autocorrelation,
}

/// Analyses trials. `models` have names and are scored on the same rows.
///
/// # Errors
/// [`AnalyzeError`].
pub fn analyze(
    trials: &[Trial],
    settings: &AnalysisSettings,
    models: &[(String, Model)],
) -> Result<Analysis, AnalyzeError> {
    check(trials, settings)?;
    let mut series = vec![analyze_series(trials, settings, models, None, Vec::new())?];
    for grid in &settings.grids {
        let (seen, left_out) = resample(trials, *grid)?;
        let grid = Some(*grid);
        series.push(analyze_series(&seen, settings, models, grid, left_out)?);
    }
    let names = |of: fn(&Trial) -> String| {
        let mut names: Vec<String> = trials.iter().map(of).collect();
        names.sort();
        names.dedup();
        names
    };
    Ok(Analysis {
        trials: trials.len(),
        robots: names(robot_of),
        groups: names(|trial| group_of(file_name(trial.path()))),
        series,
        settings: settings.clone(),
    })
}

fn check(trials: &[Trial], settings: &AnalysisSettings) -> Result<(), AnalyzeError> {
    if trials.is_empty() {
        return Err(AnalyzeError::NoTrial);
    }
    if settings.lags == 0 {
        return Err(AnalyzeError::Setting {
            what: "lags",
            found: 0,
            allowed: "1 or more",
        });
    }
    if !(1..=LAGS).contains(&settings.window) {
        return Err(AnalyzeError::Setting {
            what: "window",
            found: settings.window,
            allowed: "1 to 5",
        });
    }
    Ok(())
}

/// Each trial on the grid; trials that cannot be resampled are named.
fn resample(trials: &[Trial], grid: Resample) -> Result<(Vec<Trial>, Vec<String>), AnalyzeError> {
    let (mut seen, mut left_out) = (Vec::with_capacity(trials.len()), Vec::new());
    for trial in trials {
        match trial.resampled(grid) {
            Ok((trial, _)) => seen.push(trial),
            Err(error @ ResampleError::Rate { .. }) => return Err(error.into()),
            Err(error) => left_out.push(format!("{}: {error}", trial.path().display())),
        }
    }
    if seen.is_empty() {
        return Err(AnalyzeError::NoTrial);
    }
    Ok((seen, left_out))
}

fn analyze_series(
    trials: &[Trial],
    settings: &AnalysisSettings,
    models: &[(String, Model)],
    grid: Option<Resample>,
    mut left_out: Vec<String>,
) -> Result<Series, AnalyzeError> {
    let sources: Vec<Source> = trials.par_iter().map(source).collect();
    let assignment: Assignment = if settings.leave_out.is_empty() {
        assign(&sources, settings.split)?
    } else {
        assign_leaving_out(&sources, settings.split, &settings.leave_out)?
    };
    let found: Vec<Autocorrelation> = trials
        .par_iter()
        .map(|trial| autocorrelation(trial, settings.lags))
        .collect();
    let name = match grid {
        None => "native".to_owned(),
        Some(Resample { method, rate_hz }) => match method {
            Method::Hold => format!("held at {rate_hz} Hz"),
            Method::Mean => format!("means at {rate_hz} Hz"),
            Method::Linear => format!("interpolated at {rate_hz} Hz"),
        },
    };
    let readings: usize = found.iter().map(|found| found.readings).sum();
    let held: usize = trials.iter().map(|trial| trial.notes().held_readings).sum();
    let ablation = ablation::ablation(trials, &sources, &assignment, settings.window, models);
    let (ablation, skipped) = ablation;
    left_out.extend(skipped);
    Ok(Series {
        name,
        grid,
        rows: trials.iter().map(Trial::rows).sum(),
        readings,
        held_share: held as f64 / readings.max(1) as f64,
        mean_autocorrelation: mean(&found, settings.lags),
        pooled_autocorrelation: pooled(trials, settings.lags).at_lag,
        autocorrelations: sources
            .iter()
            .zip(found)
            .map(|(source, found)| TrialAutocorrelation {
                trial: source.trial.clone(),
                robot: source.robot.clone(),
                group: source.group.clone(),
                found,
            })
            .collect(),
        ablation,
        split: assignment.summary,
        left_out,
    })
}

fn mean(found: &[Autocorrelation], lags: usize) -> Vec<Option<f64>> {
    let at = |lag: usize| {
        let known = found.iter().filter_map(|found| found.at_lag[lag]);
        let (count, sum) = known.fold((0_usize, 0.0), |(count, sum), value| {
            (count + 1, sum + value)
        });
        (count > 0).then(|| sum / count as f64)
    };
    (0..lags).map(at).collect()
}

fn file_name(path: &Path) -> &str {
    let name = path.file_name().and_then(|name| name.to_str());
    name.unwrap_or_default()
}

fn robot_of(trial: &Trial) -> String {
    let name = trial.robot_name();
    name.unwrap_or(file_name(trial.path())).to_owned()
}

fn source(trial: &Trial) -> Source {
    Source {
        trial: trial.path().display().to_string(),
        robot: robot_of(trial),
        group: group_of(file_name(trial.path())),
        rows: trial_rows(trial),
    }
}
