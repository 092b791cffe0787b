//! Forecasters to compare with, beside persistence and the linear baselines: one tick ahead only.

use std::collections::HashMap;
use std::fmt;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use joulebus_dataset::rows::{Row, TrialRows};
use joulebus_predictor::FeatureSet;
use joulebus_train::linear::{Linear, Terms};
use serde::Deserialize;

use super::{Contents, ScoreError};

/// Position of the newest reading in the features.
const NEWEST: usize = FeatureSet::PowerOnly.first();
/// The longest season, ticks.
const MAX_SEASON: usize = 512;

/// A forecaster to compare with.
#[derive(Debug, Clone, PartialEq)]
pub enum Reference {
    /// The mean of the robot's readings so far.
    Mean,
    /// The reading one season before. The newest one where there is no season or none before.
    Seasonal,
    /// Ridge regression.
    Ridge(Terms),
    /// Another program's forecasts.
    Foreign(Arc<Foreign>),
}

impl Reference {
    /// The references that need no other program.
    pub const OWN: [Self; 3] = [Self::Mean, Self::Seasonal, Self::Ridge(Terms::AR5_AND_VELOCITIES)];
}

impl fmt::Display for Reference {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Mean => out.write_str("mean so far"),
            Self::Seasonal => out.write_str("seasonal"),
            Self::Ridge(terms) => write!(out, "ridge, {terms}"),
            Self::Foreign(foreign) => out.write_str(&foreign.name),
        }
    }
}

/// Forecasts of another program, W, by recording and row.
#[derive(Debug, Clone, PartialEq)]
pub struct Foreign {
    name: String,
    recordings: HashMap<String, HashMap<usize, [f64; 3]>>,
    has_interval: bool,
}

/// A line of its file.
#[derive(Debug, Deserialize)]
struct Line {
    /// The recording's file, with as many of its folders as distinguish it from others.
    recording: String,
    /// The file's row, from 1, whose power is forecast.
    row: usize,
    power_w: f64,
    /// The ends of the interval of the config's coverage, both or none.
    lo_w: Option<f64>,
    hi_w: Option<f64>,
}

impl Foreign {
    /// Reads a CSV with the columns `recording`, `row`, `power_w` and, if it has intervals, `lo_w`
    /// and `hi_w`.
    ///
    /// # Errors
    /// [`ScoreError::Foreign`]: it cannot be read, or a line is no forecast.
    pub fn read(name: &str, path: &Path) -> Result<Self, ScoreError> {
        let refused = |what: String| ScoreError::Foreign { name: name.to_owned(), what };
        let unreadable = |error: csv::Error| refused(format!("{}: {error}", path.display()));
        let mut reader = csv::Reader::from_path(path).map_err(unreadable)?;
        let mut recordings: HashMap<String, HashMap<usize, [f64; 3]>> = HashMap::new();
        let mut has_interval = true;
        for line in reader.deserialize() {
            let Line { recording, row, power_w, lo_w, hi_w } = line.map_err(unreadable)?;
            let [lo_w, hi_w] = [lo_w, hi_w].map(|end_w| end_w.unwrap_or(f64::NAN));
            has_interval &= lo_w <= hi_w;
            let place = format!("row {row} of {recording}");
            if !power_w.is_finite() {
                return Err(refused(format!("{place} is {power_w} W, allowed are finite powers")));
            }
            let rows = recordings.entry(recording).or_default();
            if rows.insert(row, [power_w, lo_w, hi_w]).is_some() {
                return Err(refused(format!("{place} is there twice. Leave one out")));
            }
        }
        Ok(Self { name: name.to_owned(), recordings, has_interval })
    }

    /// The forecasts of a recording's rows and their intervals.
    ///
    /// # Errors
    /// [`ScoreError::Foreign`]: an evaluated row has no forecast.
    fn of(
        &self,
        name: &str,
        contents: &Contents,
        evaluated: &[Range<usize>],
    ) -> Result<Vec<[f64; 3]>, ScoreError> {
        // A recording of several robots is named as its file, too.
        let path = contents.trial.path();
        let mut named = self.recordings.iter();
        let own = named.find(|(key, _)| path.ends_with(key) || name == *key).map(|(_, rows)| rows);
        let seqs = contents.rows.sample_seq.iter();
        let found: Vec<[f64; 3]> = seqs
            .map(|seq| {
                let row = contents.trial.data_row(*seq as usize + 1);
                own.and_then(|own| own.get(&row)).copied().unwrap_or([f64::NAN; 3])
            })
            .collect();
        let rows = evaluated.iter().cloned().flatten();
        let lacking = rows.clone().filter(|row| found[*row][0].is_nan()).count();
        match lacking {
            0 => Ok(found),
            _ => Err(ScoreError::Foreign {
                name: self.name.clone(),
                what: format!(
                    "{name}: {lacking} of the {} evaluated rows have no forecast, allowed is one \
                        for each",
                    rows.count()
                ),
            }),
        }
    }
}

/// A reference, fitted to the rows of a fold.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Learned {
    Nothing,
    /// Ticks, if the readings have a season.
    Season(Option<usize>),
    /// `None` if there are too few rows.
    Ridge(Option<Linear>),
}

/// Forecasts of a reference for each row of a recording, W. Without an interval its ends are NaN.
pub(super) fn forecasts_w(
    (reference, learned): (&Reference, &Learned),
    name: &str,
    contents: &Contents,
    evaluated: &[Range<usize>],
) -> Result<Vec<[f64; 3]>, ScoreError> {
    let rows = &contents.rows.rows;
    let alone = |power_w: f64| [power_w, f64::NAN, f64::NAN];
    Ok(match (reference, learned) {
        (Reference::Foreign(foreign), _) => foreign.of(name, contents, evaluated)?,
        (_, Learned::Ridge(line)) => rows
            .iter()
            .map(|row| alone(line.as_ref().map_or(f64::NAN, |line| line.predict(&row.features))))
            .collect(),
        (_, Learned::Season(season)) => {
            let before = |at: usize| {
                let earlier = at.checked_sub((*season)?)?;
                follows(&contents.rows, earlier, at).then(|| rows[earlier].target_w)
            };
            let newest = |at: usize| rows[at].features[NEWEST];
            (0..rows.len())
                .map(|at| alone(before(at).unwrap_or_else(|| newest(at)).into()))
                .collect()
        }
        _ => {
            let mut sum_w = 0.0;
            let mean = |(at, row): (usize, &Row)| {
                sum_w += f64::from(row.features[NEWEST]);
                alone(sum_w / (at + 1) as f64)
            };
            rows.iter().enumerate().map(mean).collect()
        }
    })
}

impl Reference {
    /// True if it has intervals.
    pub(super) fn has_interval(&self) -> bool {
        matches!(self, Self::Foreign(foreign) if foreign.has_interval)
    }
}

/// True if no gap lies between two rows.
fn follows(rows: &TrialRows, earlier: usize, later: usize) -> bool {
    let [before, after] = [earlier, later].map(|at| rows.sample_seq[at]);
    after - before == (later - earlier) as u64
}

/// Squared differences of readings some ticks apart, of which the season follows.
#[derive(Debug, Clone)]
pub(super) struct Differences {
    /// Number, sum and sum of squares of the readings.
    readings: [f64; 3],
    /// For each distance from 1: number and sum of squared differences.
    at: Vec<[f64; 2]>,
}

impl Differences {
    pub(super) fn none() -> Self {
        Self { readings: [0.0; 3], at: vec![[0.0; 2]; MAX_SEASON] }
    }

    /// The sums of some rows of a trial.
    pub(super) fn new(rows: &TrialRows, part: Range<usize>) -> Self {
        let mut found = Self::none();
        for later in part.clone() {
            let later_w = f64::from(rows.rows[later].target_w);
            for (sum, value) in found.readings.iter_mut().zip([1.0, later_w, later_w * later_w]) {
                *sum += value;
            }
            for (distance, sums) in (1..).zip(&mut found.at) {
                let Some(earlier) = later.checked_sub(distance).filter(|at| *at >= part.start)
                else {
                    break;
                };
                if !follows(rows, earlier, later) {
                    break;
                }
                let apart_w = later_w - f64::from(rows.rows[earlier].target_w);
                *sums = [sums[0] + 1.0, sums[1] + apart_w * apart_w];
            }
        }
        found
    }

    pub(super) fn merge(&mut self, other: &Self) {
        let sums = self.readings.iter_mut().zip(other.readings);
        sums.for_each(|(sum, other)| *sum += other);
        let sums = self.at.iter_mut().zip(&other.at);
        sums.for_each(|(sum, other)| *sum = [sum[0] + other[0], sum[1] + other[1]]);
    }

    /// The distance of the highest autocorrelation after the first that is not above 0, if that
    /// autocorrelation is above 0.
    pub(super) fn season(&self) -> Option<usize> {
        let [count, sum, squares] = self.readings;
        let variance = squares / count - (sum / count) * (sum / count);
        // Few pairs prove little.
        let pairs = self.at.iter().take_while(|[pairs, _]| *pairs > 0.1 * count);
        let correlation = pairs.map(|[pairs, squares]| 1.0 - squares / pairs / (2.0 * variance));
        let after = (1..).zip(correlation).skip_while(|(_, correlation)| *correlation > 0.0);
        let best = after.reduce(|best, next| if next.1 > best.1 { next } else { best })?;
        (best.1 > 0.0).then_some(best.0)
    }
}

#[cfg(test)]
mod tests {
    use joulebus_predictor::INPUTS;

    use super::*;

    #[test]
    fn the_season_of_a_wave_is_its_period_and_steps_at_random_have_none() {
        let rows = |power_w: &dyn Fn(usize) -> f64| TrialRows {
            rows: (0..2_000).map(|at| Row::new([0.0; INPUTS], power_w(at) as f32)).collect(),
            sample_seq: (0..2_000).collect(),
            ..TrialRows::default()
        };
        let season = |rows: &TrialRows| {
            let mut all = Differences::new(rows, 0..1_000);
            all.merge(&Differences::new(rows, 1_000..2_000));
            all.season()
        };
        let wave = rows(&|at| 50.0 + (at as f64 * std::f64::consts::TAU / 90.0).sin());
        assert_eq!(season(&wave).map(|ticks| ticks % 90), Some(0));
        assert_eq!(season(&rows(&|_| 5.0)), None);
        assert_eq!(season(&rows(&|at| at as f64)), None);
    }
}
