//! Which of the scored rows a model was trained on.

use joulebus_dataset::trained_rows::is_trained_on;
use joulebus_predictor::Model;
use serde::{Deserialize, Serialize};

use super::design::Part;
use super::{Design, Recording};
use crate::evaluate::RobotEvaluation;

/// Fewer rows than these are not worth a headline: 1.7 s at 30 Hz.
const FEWEST_APART: usize = 50;

/// Rows that a model was trained on, among those that were to be evaluated.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TrainedOn {
    /// Rows trained on, or beside such rows.
    pub rows: usize,
    /// Rows to be evaluated.
    pub of: usize,
    /// Their quotient; NaN without a row.
    pub share: f64,
}

/// What the rows of the tables are to the models.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ScoredRows {
    /// No model was trained on any of them.
    NotTrainedOn,
    /// A model was trained on all of them.
    TrainedOn,
    /// A model was trained on some of them.
    Mixed,
    /// A model's file does not state the rows it was trained on, and no other model was trained on them.
    Unknown,
}

/// For each row, whether the model was trained on it; `None` if its file does not state that.
fn mask(model: &Model, recording: &Recording) -> Option<Vec<bool>> {
    let rows = &recording.rows.rows;
    match model {
        Model::Persistence(_) => Some(vec![false; rows.len()]),
        Model::Network(network) => {
            let trained = network.card().trained_rows.as_ref()?;
            Some(is_trained_on(rows, trained))
        }
    }
}

/// Rows of the parts that the model was trained on.
fn count<'a>(
    model: &Model,
    recordings: &[Recording],
    parts: impl Iterator<Item = &'a Part>,
) -> Option<TrainedOn> {
    let (mut rows, mut of) = (0, 0);
    for (at, part) in parts {
        let mask = mask(model, recordings.get(*at)?)?;
        rows += mask[part.clone()]
            .iter()
            .filter(|trained| **trained)
            .count();
        of += part.len();
    }
    let share = rows as f64 / of as f64;
    Some(TrainedOn { rows, of, share })
}

impl Design {
    /// Moves the evaluated rows that a model was trained on into
    /// [`Fold::trained_on`](super::Fold::trained_on), to be scored apart. Nothing is moved if fewer than
    /// 50 others would be left: [`ScoredRows`] then states what the scores are of.
    #[must_use]
    pub fn hold_apart(mut self, recordings: &[Recording], models: &[Model]) -> Self {
        let before = self.folds.clone();
        for fold in &mut self.folds {
            let mut evaluated = Vec::new();
            for (at, part) in std::mem::take(&mut fold.evaluated) {
                let Some(recording) = recordings.get(at) else {
                    evaluated.push((at, part));
                    continue;
                };
                let mut trained = vec![false; recording.rows.rows.len()];
                for mask in models.iter().filter_map(|model| mask(model, recording)) {
                    for (any, one) in trained.iter_mut().zip(mask) {
                        *any |= one;
                    }
                }
                let mut end = part.start;
                for stretch in trained[part].chunk_by(|a, b| a == b) {
                    let start = end;
                    end += stretch.len();
                    let to = if stretch[0] {
                        &mut fold.trained_on
                    } else {
                        &mut evaluated
                    };
                    to.push((at, start..end));
                }
            }
            fold.evaluated = evaluated;
        }
        let left: usize = self.parts().map(|part| part.1.len()).sum();
        if left < FEWEST_APART {
            self.folds = before;
        }
        self
    }

    fn parts(&self) -> impl Iterator<Item = &Part> {
        self.folds.iter().flat_map(|fold| &fold.evaluated)
    }

    /// Of the rows to be evaluated, those that the model was trained on; `None` if its file does not
    /// state them.
    pub(super) fn trained_on(&self, recordings: &[Recording], model: &Model) -> Option<TrainedOn> {
        let apart = self.folds.iter().flat_map(|fold| &fold.trained_on);
        count(model, recordings, self.parts().chain(apart))
    }

    /// What the evaluated rows are to the models.
    pub(super) fn scored_rows(&self, recordings: &[Recording], models: &[Model]) -> ScoredRows {
        let counts = models.iter();
        let counts = counts.map(|model| count(model, recordings, self.parts()));
        let counts: Vec<Option<TrainedOn>> = counts.collect();
        let known = || counts.iter().flatten();
        if known().any(|found| found.rows > 0) {
            match known().any(|found| found.rows == found.of) {
                true => ScoredRows::TrainedOn,
                false => ScoredRows::Mixed,
            }
        } else if counts.iter().any(Option::is_none) {
            ScoredRows::Unknown
        } else {
            ScoredRows::NotTrainedOn
        }
    }

    /// Marks readings of rows that are not evaluated as not scored, and sums the scores again without
    /// them. Readings that belong to no row, after gaps, stay.
    pub fn restrict(&self, at: usize, recording: &Recording, live: &mut RobotEvaluation) {
        let rows = recording.rows.rows.len();
        let mut left_out = vec![true; rows];
        for (_, part) in self.evaluated(at) {
            left_out[part].fill(false);
        }
        let seqs = recording.rows.sample_seq.iter().zip(left_out);
        let mut any = false;
        for (seq, _) in seqs.filter(|(_, is_out)| *is_out) {
            // A row's target is the reading of the next sample.
            if let Some(step) = live.steps.get_mut(*seq as usize + 1) {
                step.scored = false;
                any = true;
            }
        }
        if any {
            live.score_again();
        }
    }
}

/// What must be known before the scores are read.
pub(super) fn warnings<'a>(
    models: impl Iterator<Item = (&'a str, Option<TrainedOn>)>,
    scored: ScoredRows,
) -> Vec<String> {
    let of_model = |(name, trained_on): (&str, Option<TrainedOn>)| {
        let Some(TrainedOn { rows, of, share }) = trained_on else {
            return Some(format!(
                "whether {name} was trained on the scored rows is unknown: its file does not state its rows"
            ));
        };
        let percent = 100.0 * share;
        let consequence = match scored {
            _ if rows == 0 => return None,
            ScoredRows::NotTrainedOn | ScoredRows::Unknown => "they are scored apart",
            ScoredRows::TrainedOn | ScoredRows::Mixed => {
                "these scores say nothing about recordings that it has not seen"
            }
        };
        Some(format!(
            "{name} was trained on {percent:.1} % of the rows ({rows} of {of}): {consequence}"
        ))
    };
    models.filter_map(of_model).collect()
}
