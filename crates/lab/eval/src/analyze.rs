//! Analysis of a dataset before training (arXiv 2603.13908, section 4): autocorrelation of
//! readings, the gain of each kind of input, and the share of a score that comes from held
//! readings.

mod ablation;
mod autocorrelation;
mod error;
mod view;

use joulebus_predictor::{LAGS, Model};
use serde::{Deserialize, Serialize};

use crate::score::{Contents, Recording};
use joulebus_dataset::split::{
    Assignment, SourceInfo, Split, SplitSummary, assign, assign_leaving_out, digest, resume,
};
use joulebus_dataset::trial::{Method, Resample};

pub use ablation::{Ablation, Member, Part};
pub use autocorrelation::{Autocorrelation, autocorrelation, pooled};
pub use error::AnalyzeError;

use ablation::velocities_known;
use autocorrelation::LagSums;
use view::View;

/// Settings of an analysis.
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
            grids: vec![Resample { method: Method::Hold, rate_hz: 30.0 }],
            split: Split { held_out: 0.3, ..Split::default() },
            leave_out: Vec::new(),
        }
    }
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
    /// The grid. `None` for the native series.
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
    /// The gain of each kind of input. `None`, with the reason in `left_out`, if it could not be
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

/// Analyses recordings. Each is read four times if it is not in memory. `models` have names and are
/// scored on the same rows.
///
/// # Errors
/// [`AnalyzeError`].
pub fn analyze(
    recordings: &[Recording],
    settings: &AnalysisSettings,
    models: &[(String, Model)],
) -> Result<Analysis, AnalyzeError> {
    check(recordings, settings)?;
    let mut series = vec![analyze_series(View::native(recordings), settings, models, None)?];
    for grid in &settings.grids {
        let view = View::on(recordings, *grid);
        series.push(analyze_series(view, settings, models, Some(*grid))?);
    }
    let names = |of: fn(&Recording) -> &String| {
        let mut names: Vec<String> = recordings.iter().map(|one| of(one).clone()).collect();
        names.sort();
        names.dedup();
        names
    };
    Ok(Analysis {
        trials: recordings.len(),
        robots: names(|recording| &recording.robot),
        groups: names(|recording| &recording.group),
        series,
        settings: settings.clone(),
    })
}

/// Maximum number of lags of an autocorrelation: more than five minutes at 30 Hz.
const MAX_LAGS: usize = 10_000;

fn check(recordings: &[Recording], settings: &AnalysisSettings) -> Result<(), AnalyzeError> {
    if recordings.is_empty() {
        return Err(AnalyzeError::NoTrial);
    }
    if !(1..=MAX_LAGS).contains(&settings.lags) {
        return Err(AnalyzeError::Setting {
            what: "lags",
            found: settings.lags,
            allowed: "1 to 10,000",
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

/// Facts from the first reading of a trial.
struct Seen {
    info: SourceInfo,
    rows: usize,
    held: usize,
    sums: LagSums,
    has_velocities: bool,
}

impl Seen {
    fn new(recording: &Recording, contents: &Contents, lags: usize) -> Self {
        let Contents { trial, rows, .. } = contents;
        Self {
            info: SourceInfo {
                trial: recording.file().to_owned(),
                rows: rows.rows.len(),
                digest: digest(rows),
                period_s: rows.period_s,
                ..recording.info()
            },
            rows: trial.rows(),
            held: trial.notes().held_readings,
            sums: LagSums::new(trial, lags),
            has_velocities: rows.rows.iter().any(|row| velocities_known(&row.features)),
        }
    }
}

fn analyze_series(
    view: View<'_>,
    settings: &AnalysisSettings,
    models: &[(String, Model)],
    grid: Option<Resample>,
) -> Result<Series, AnalyzeError> {
    let (mut seen, mut left_out) = (Vec::new(), Vec::new());
    let mut is_left_out = vec![false; view.recordings().len()];
    view.each_that_fits(
        |at, contents| Seen::new(view.recordings()[at], contents, settings.lags),
        |at, found| match found {
            Ok(found) => seen.push(found),
            Err(reason) => {
                is_left_out[at] = true;
                left_out.push(reason);
            }
        },
    )?;
    if seen.is_empty() {
        return Err(AnalyzeError::NoTrial);
    }
    let view = view.without(&is_left_out);
    let infos: Vec<SourceInfo> = seen.iter().map(|seen| seen.info.clone()).collect();
    let assignment = assigned(&view, &infos, settings)?;
    let has_velocities = seen.iter().any(|seen| seen.has_velocities);
    let ranges = &assignment.ranges;
    let ablation = ablation::ablation(&view, ranges, has_velocities, settings.window, models)?;
    let (ablation, skipped) = ablation;
    left_out.extend(skipped);
    let sums: Vec<LagSums> = seen.iter().map(|seen| seen.sums.clone()).collect();
    let found: Vec<Autocorrelation> = sums.iter().map(LagSums::alone).collect();
    let readings: usize = sums.iter().map(LagSums::readings).sum();
    let held: usize = seen.iter().map(|seen| seen.held).sum();
    Ok(Series {
        name: name_of(grid),
        grid,
        rows: seen.iter().map(|seen| seen.rows).sum(),
        readings,
        held_share: held as f64 / readings.max(1) as f64,
        mean_autocorrelation: mean(&found, settings.lags),
        pooled_autocorrelation: LagSums::pooled(&sums, settings.lags).at_lag,
        autocorrelations: infos
            .into_iter()
            .zip(found)
            .map(|(info, found)| TrialAutocorrelation {
                trial: info.trial,
                robot: info.robot,
                group: info.group,
                found,
            })
            .collect(),
        ablation,
        split: assignment.summary,
        left_out,
    })
}

fn assigned(
    view: &View<'_>,
    infos: &[SourceInfo],
    settings: &AnalysisSettings,
) -> Result<Assignment, AnalyzeError> {
    match settings.leave_out.as_slice() {
        [] => assign(infos, settings.split, |at, cuts| Ok(resume(&view.contents(at)?.rows, cuts))),
        names => Ok(assign_leaving_out(infos, settings.split, names)?),
    }
}

fn name_of(grid: Option<Resample>) -> String {
    let Some(Resample { method, rate_hz }) = grid else {
        return "native".to_owned();
    };
    match method {
        Method::Hold => format!("held at {rate_hz} Hz"),
        Method::Mean => format!("means at {rate_hz} Hz"),
        Method::Linear => format!("interpolated at {rate_hz} Hz"),
    }
}

fn mean(found: &[Autocorrelation], lags: usize) -> Vec<Option<f64>> {
    let at = |lag: usize| {
        let known = found.iter().filter_map(|found| found.at_lag[lag]);
        let (count, sum) =
            known.fold((0_usize, 0.0), |(count, sum), value| (count + 1, sum + value));
        (count > 0).then(|| sum / count as f64)
    };
    (0..lags).map(at).collect()
}
