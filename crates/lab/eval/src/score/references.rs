//! Forecasters to compare with, beside persistence and the linear baselines: one tick ahead only.

use std::collections::HashMap;
use std::fmt;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use joulebus_dataset::rows::Row;
use joulebus_predictor::FeatureSet;
use joulebus_train::linear::{Linear, Terms};
use serde::Deserialize;

use super::{Contents, ScoreError};

/// Position of the newest reading in the features.
const NEWEST: usize = FeatureSet::PowerOnly.first();

/// A forecaster to compare with.
#[derive(Debug, Clone, PartialEq)]
pub enum Reference {
    /// The mean of the robot's readings so far.
    Mean,
    /// Ridge regression.
    Ridge(Terms),
    /// Another program's forecasts.
    Foreign(Arc<Foreign>),
}

impl Reference {
    /// The references that need no other program.
    pub const OWN: [Self; 2] = [Self::Mean, Self::Ridge(Terms::AR5_AND_VELOCITIES)];
}

impl fmt::Display for Reference {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Mean => out.write_str("mean so far"),
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
