//! Recognises the scored rows that a model was trained on.

use std::ops::Range;

use joulebus_dataset::trained_rows::{is_trained_on, is_untold};
use joulebus_predictor::Model;
use joulebus_predictor::training::TrainedRows;
use serde::Serialize;

use super::design::Part;
use super::{Contents, Design, Recording, ScoreError, each};
use crate::evaluate::RobotEvaluation;

/// Fewer rows than these are not worth a headline: 1.7 s at 30 Hz.
const FEWEST_APART: usize = 50;

/// A recording's period differs from that of the training by at most this share of it, unless it is
/// resampled.
const MAX_PERIOD_DIFFERENCE: f32 = 0.2;

/// Rows that a model was trained on, among those that were to be evaluated.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TrainedOn {
    /// Rows trained on, or beside such rows, as far as recognised.
    pub rows: usize,
    /// Rows in pieces too short, or that change too rarely, to be recognised, and rows of recordings
    /// with another period than the training's.
    pub untold: usize,
    /// Rows to be evaluated.
    pub of: usize,
    /// Their quotient. NaN without a row.
    pub share: f64,
}

/// Relation of the tables' rows to the models' training.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ScoredRows {
    /// All of them would be recognised if a model was trained on them, and none is.
    NotTrainedOn,
    /// None of them is recognised, but some [cannot be told](TrainedOn::untold).
    NoneRecognised,
    /// A model was trained on all of them.
    TrainedOn,
    /// A model was trained on some of them.
    Mixed,
    /// A model's file does not state the rows it was trained on, and no other model was trained on
    /// them.
    Unknown,
}

/// The rows of some recordings that models were trained on.
pub(super) struct Recognised {
    /// `None` if the model's file does not state its rows.
    of: Vec<Option<OfModel>>,
}

/// Stretches of each recording's rows, ascending.
type Stretches = Vec<Vec<Range<usize>>>;

#[derive(Clone)]
struct OfModel {
    /// Trained on.
    known: Stretches,
    /// Neither recognised nor told from rows that were trained on.
    untold: Stretches,
}

impl Recognised {
    pub(super) fn new(recordings: &[Recording], models: &[Model]) -> Result<Self, ScoreError> {
        let stated = models.iter().map(|model| match model {
            Model::Persistence(_) => None,
            Model::Network(network) => network.card().trained_rows.as_ref(),
        });
        let stated: Vec<Option<&TrainedRows>> = stated.collect();
        let of = models.iter().zip(&stated);
        let of = of.map(|(model, stated)| match model {
            Model::Persistence(_) => {
                let none = vec![Vec::new(); recordings.len()];
                Some(OfModel { known: none.clone(), untold: none })
            }
            Model::Network(_) => stated.map(|_| OfModel { known: Vec::new(), untold: Vec::new() }),
        });
        let mut of: Vec<Option<OfModel>> = of.collect();
        if stated.iter().all(Option::is_none) {
            return Ok(Self { of });
        }
        each(
            &recordings.iter().collect::<Vec<_>>(),
            |at| {
                let contents = recordings[at].contents()?;
                let rows = &contents.rows.rows;
                let found = models.iter().zip(&stated).map(|(model, stated)| {
                    let stated = (*stated)?;
                    let is_known = is_trained_on(rows, stated);
                    let is_untold = match is_of_its_rate(model, contents.rows.period_s) {
                        true => is_untold(rows, &is_known, stated),
                        false => is_known.iter().map(|is_known| !is_known).collect(),
                    };
                    Some((stretches(&is_known), stretches(&is_untold)))
                });
                Ok::<_, ScoreError>(found.collect::<Vec<_>>())
            },
            |_, found| {
                for (all, found) in of.iter_mut().zip(found) {
                    if let (Some(all), Some((known, untold))) = (all, found) {
                        all.known.push(known);
                        all.untold.push(untold);
                    }
                }
                Ok(())
            },
        )?;
        Ok(Self { of })
    }

    /// Rows of the parts that a model was trained on. `None` if that is not known.
    fn count<'a>(&self, model: usize, parts: impl Iterator<Item = &'a Part>) -> Option<TrainedOn> {
        let of_model = self.of.get(model)?.as_ref()?;
        let (mut rows, mut untold, mut of) = (0, 0, 0);
        let count = |stretches: &[Range<usize>], part: &Range<usize>| -> usize {
            stretches.iter().map(|one| overlap(one, part)).sum()
        };
        for (at, part) in parts {
            rows += count(of_model.known.get(*at)?, part);
            untold += count(of_model.untold.get(*at)?, part);
            of += part.len();
        }
        let share = rows as f64 / of as f64;
        Some(TrainedOn { rows, untold, of, share })
    }

    /// Rows of the parts of which a model's hashes tell nothing.
    fn untold<'a>(&self, parts: impl Iterator<Item = &'a Part>) -> usize {
        let of_part = |(at, part): &Part| {
            let mut is_untold = vec![false; part.len()];
            let untold = self.of.iter().flatten().filter_map(|model| model.untold.get(*at));
            for stretch in untold.flatten() {
                let start = stretch.start.max(part.start);
                let end = stretch.end.min(part.end);
                if start < end {
                    is_untold[start - part.start..end - part.start].fill(true);
                }
            }
            is_untold.iter().filter(|untold| **untold).count()
        };
        parts.map(of_part).sum()
    }

    /// For each of a recording's rows, whether any of the models was trained on it.
    fn by_any(&self, recording: usize, rows: usize) -> Vec<bool> {
        let mut trained = vec![false; rows];
        let of = self.of.iter().flatten();
        for stretch in of.filter_map(|model| model.known.get(recording)).flatten() {
            trained[stretch.clone()].fill(true);
        }
        trained
    }
}

/// False if a recording's period is another than that of the model's training. Then it may be a
/// resampled copy, which is not recognised.
fn is_of_its_rate(model: &Model, period_s: f32) -> bool {
    let Model::Network(network) = model else {
        return true;
    };
    network.card().period_s().is_none_or(|trained_s| {
        let difference_s = (period_s - trained_s).abs();
        difference_s <= MAX_PERIOD_DIFFERENCE * trained_s
    })
}

/// The ranges in which a mask is true.
fn stretches(mask: &[bool]) -> Vec<Range<usize>> {
    let mut end = 0;
    let all = mask.chunk_by(|a, b| a == b).map(|stretch| {
        let start = end;
        end += stretch.len();
        (stretch[0], start..end)
    });
    all.filter_map(|(is_trained, range)| is_trained.then_some(range)).collect()
}

fn overlap(one: &Range<usize>, other: &Range<usize>) -> usize {
    let end = one.end.min(other.end);
    end.saturating_sub(one.start.max(other.start))
}

impl Design {
    /// Moves the evaluated rows that a model was trained on into
    /// [`Fold::trained_on`](super::Fold::trained_on), to be scored apart. Moves nothing if fewer
    /// than 50 others would be left. [`ScoredRows`] then states which rows are scored.
    ///
    /// # Errors
    /// [`ScoreError::Recording`].
    pub fn hold_apart(
        mut self,
        recordings: &[Recording],
        models: &[Model],
    ) -> Result<Self, ScoreError> {
        let recognised = Recognised::new(recordings, models)?;
        let before = self.folds.clone();
        for fold in &mut self.folds {
            let mut evaluated = Vec::new();
            for (at, part) in std::mem::take(&mut fold.evaluated) {
                let Some(recording) = recordings.get(at) else {
                    evaluated.push((at, part));
                    continue;
                };
                let trained = recognised.by_any(at, recording.rows());
                let mut end = part.start;
                for stretch in trained[part].chunk_by(|a, b| a == b) {
                    let start = end;
                    end += stretch.len();
                    let to = if stretch[0] { &mut fold.trained_on } else { &mut evaluated };
                    to.push((at, start..end));
                }
            }
            fold.evaluated = evaluated;
        }
        let left: usize = self.parts().map(|part| part.1.len()).sum();
        if left < FEWEST_APART {
            self.folds = before;
        }
        Ok(self)
    }

    fn parts(&self) -> impl Iterator<Item = &Part> {
        self.folds.iter().flat_map(|fold| &fold.evaluated)
    }

    /// The rows to evaluate that the model was trained on. `None` if its file does not state them.
    pub(super) fn trained_on(&self, recognised: &Recognised, model: usize) -> Option<TrainedOn> {
        let apart = self.folds.iter().flat_map(|fold| &fold.trained_on);
        recognised.count(model, self.parts().chain(apart))
    }

    /// The evaluated rows of which a model's hashes tell nothing.
    pub(super) fn untold_rows(&self, recognised: &Recognised) -> usize {
        recognised.untold(self.parts())
    }

    /// Relation of the evaluated rows to the models' training.
    pub(super) fn scored_rows(&self, recognised: &Recognised) -> ScoredRows {
        let counts = 0..recognised.of.len();
        let counts = counts.map(|model| recognised.count(model, self.parts()));
        let counts: Vec<Option<TrainedOn>> = counts.collect();
        let known = || counts.iter().flatten();
        if known().any(|found| found.rows > 0) {
            match known().any(|found| found.rows == found.of) {
                true => ScoredRows::TrainedOn,
                false => ScoredRows::Mixed,
            }
        } else if counts.iter().any(Option::is_none) {
            ScoredRows::Unknown
        } else if known().any(|found| found.untold > 0) {
            ScoredRows::NoneRecognised
        } else {
            ScoredRows::NotTrainedOn
        }
    }

    /// Marks readings of rows that are not evaluated as not scored, and sums the scores again
    /// without them. Readings that belong to no row, after gaps, stay.
    pub fn restrict(&self, at: usize, contents: &Contents, live: &mut RobotEvaluation) {
        let rows = contents.rows.rows.len();
        let mut left_out = vec![true; rows];
        for (_, part) in self.evaluated(at) {
            left_out[part].fill(false);
        }
        let seqs = contents.rows.sample_seq.iter().zip(left_out);
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

/// Warnings for the reader of the scores.
pub(super) fn warnings<'a>(
    models: impl Iterator<Item = (&'a str, Option<TrainedOn>)>,
    scored: ScoredRows,
) -> Vec<String> {
    let of_model = |(name, trained_on): (&str, Option<TrainedOn>)| {
        let Some(TrainedOn { rows, of, share, .. }) = trained_on else {
            return Some(format!(
                "whether {name} was trained on the scored rows is unknown: its file does not state its rows"
            ));
        };
        let percent = 100.0 * share;
        let consequence = match scored {
            _ if rows == 0 => return None,
            ScoredRows::NotTrainedOn | ScoredRows::NoneRecognised | ScoredRows::Unknown => {
                "they are scored apart"
            }
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
