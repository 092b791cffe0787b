//! The rows to evaluate, and the rows to fit the baselines on.

use std::collections::{HashMap, HashSet};
use std::ops::Range;

use serde::Serialize;

use super::references::Learned;
use super::{Recording, Reference, ScoreError, each, sources};
use joulebus_dataset::rows::TrialRows;
use joulebus_dataset::split::{
    Assignment, By, PAUSE_ROWS, SourceInfo, Split, assign, assign_leaving_out, left_out, resume,
};
use joulebus_train::linear::{KnownFeatures, Linear, Moments, Terms};

/// Maximum number of folds of [`Design::folds`].
const MAX_FOLDS: usize = 10;

/// Index of a recording, and a range of its rows.
pub type Part = (usize, Range<usize>);

/// Evaluated rows, and the rows that baselines for them are fitted on. The two never share a
/// reading.
#[derive(Debug, Clone, PartialEq)]
pub struct Design {
    /// Description: what was held out, or how the folds were made.
    pub description: String,
    /// The split, if one was requested.
    pub split: Option<Split>,
    /// One or more folds.
    pub folds: Vec<Fold>,
    /// Names of the evaluated units. For a split in time, and without a split, the trials.
    pub units: Vec<String>,
    /// Recordings used only for fitting.
    others: Vec<Recording>,
}

/// Rows that are evaluated with the same baselines.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Fold {
    /// Indices of recordings with their evaluated rows.
    pub evaluated: Vec<Part>,
    /// Indices of recordings with the rows that the baselines are fitted on. Indices beyond the
    /// evaluated recordings are of those used only for fitting.
    pub fitted: Vec<Part>,
    /// Rows that a model was trained on, with these baselines: scored apart
    /// ([`Design::hold_apart`]).
    pub trained_on: Vec<Part>,
}

impl Design {
    /// Evaluates the held-out part of a split. Baselines are fitted on all other rows, the
    /// validation part included, because they need no early stopping.
    ///
    /// The parts are those of [`assign`]: a model trained with the same split of the same
    /// recordings has not seen the evaluated rows.
    ///
    /// # Errors
    /// [`ScoreError::Split`]. [`ScoreError::Recording`] in a split in time.
    pub fn held_out(recordings: &[Recording], wanted: Split) -> Result<Self, ScoreError> {
        let infos = sources(recordings);
        let resume_at = |at: usize, cuts| -> Result<[usize; 2], ScoreError> {
            let contents = recordings[at].contents()?;
            Ok(resume(&contents.rows, cuts))
        };
        let assignment = assign(&infos, wanted, resume_at)?;
        Ok(Self::assigned(assignment, wanted))
    }

    /// The same with the held-out units given by name: surfaces or robots unknown to the model.
    ///
    /// # Errors
    /// [`ScoreError::Split`].
    pub fn leaving_out(
        recordings: &[Recording],
        wanted: Split,
        names: &[String],
    ) -> Result<Self, ScoreError> {
        let assignment = assign_leaving_out(&infos(recordings), wanted, names)?;
        Ok(Self::assigned(assignment, wanted))
    }

    /// Evaluates the recordings that a shift leaves out, with baselines fitted on all others:
    /// groups, folders, robots or trials of these names.
    ///
    /// # Errors
    /// [`ScoreError::Split`].
    pub fn shifted(recordings: &[Recording], names: &[String]) -> Result<Self, ScoreError> {
        let is_out = left_out(&infos(recordings), names)?;
        let mut fold = Fold::default();
        for ((at, recording), out) in recordings.iter().enumerate().zip(is_out) {
            let parts = if out { &mut fold.evaluated } else { &mut fold.fitted };
            parts.push((at, 0..recording.rows()));
        }
        Ok(Self {
            description: format!(
                "left out: {}. Baselines are fitted on all others",
                names.join(", ")
            ),
            split: None,
            folds: vec![fold],
            units: names.to_vec(),
            others: Vec::new(),
        })
    }

    fn assigned(assignment: Assignment, wanted: Split) -> Self {
        let mut fold = Fold::default();
        for (at, [training, validation, held_out]) in assignment.ranges.iter().cloned().enumerate()
        {
            fold.fitted.extend([(at, training), (at, validation)]);
            fold.evaluated.push((at, held_out));
        }
        for parts in [&mut fold.fitted, &mut fold.evaluated] {
            parts.retain(|part| !part.1.is_empty());
        }
        Self {
            description: format!("split {}", assignment.summary.name),
            split: Some(wanted),
            folds: vec![fold],
            units: match wanted.by {
                By::Time => assignment.summary.training,
                _ => assignment.summary.held_out,
            },
            others: Vec::new(),
        }
    }

    /// Evaluates every row. The recordings are assigned in turn to up to ten folds, and the
    /// baselines for each are fitted on the others. A single recording is cut into halves, each
    /// evaluated with baselines from the other. Duplicates of a recording share its fold.
    pub fn folds(recordings: &[Recording]) -> Self {
        let infos = infos(recordings);
        let units: HashSet<_> = infos.iter().map(|one| (&one.trial, &one.robot)).collect();
        let count = units.len().min(MAX_FOLDS);
        let folds = match (count, recordings) {
            (1, [only]) => in_halves(only.rows()),
            (1, parts) => in_two(parts),
            _ => in_turn(recordings, count),
        };
        let description = match count {
            1 => "no split: all rows. Baselines of each half are fitted on the other".to_owned(),
            _ => format!(
                "no split: all trials. Baselines are fitted on the other trials, {count} folds"
            ),
        };
        Self { description, split: None, folds, units: names(recordings), others: Vec::new() }
    }

    /// Evaluates every row. Baselines are fitted on other recordings.
    pub fn fitted_on(recordings: &[Recording], others: Vec<Recording>) -> Self {
        let whole = |(at, recording): (usize, &Recording)| (at, 0..recording.rows());
        let fold = Fold {
            evaluated: recordings.iter().enumerate().map(whole).collect(),
            fitted: (recordings.len()..).zip(&others).map(whole).collect(),
            trained_on: Vec::new(),
        };
        Self {
            description: format!("all trials. Baselines are fitted on {} named ones", others.len()),
            split: None,
            folds: vec![fold],
            units: names(recordings),
            others,
        }
    }

    /// Refuses recordings that lack rows of the design.
    pub(super) fn check(&self, recordings: &[Recording]) -> Result<(), ScoreError> {
        let all: Vec<usize> = recordings.iter().chain(&self.others).map(Recording::rows).collect();
        let parts = self
            .folds
            .iter()
            .flat_map(|fold| [&fold.evaluated, &fold.fitted, &fold.trained_on])
            .flatten();
        for (recording, rows) in parts {
            let allowed = all.get(*recording).copied().unwrap_or(0);
            if rows.end > allowed {
                return Err(ScoreError::Design {
                    recording: *recording,
                    found: rows.end - 1,
                    allowed,
                });
            }
        }
        Ok(())
    }

    /// Row ranges of a recording that are evaluated, each with the index of its fold.
    pub fn evaluated(&self, recording: usize) -> impl Iterator<Item = (usize, Range<usize>)> + '_ {
        self.ranges(recording, |fold| &fold.evaluated)
    }

    /// Row ranges of a recording that are scored apart, each with the index of its fold.
    pub(super) fn apart(
        &self,
        recording: usize,
    ) -> impl Iterator<Item = (usize, Range<usize>)> + '_ {
        self.ranges(recording, |fold| &fold.trained_on)
    }

    fn ranges(
        &self,
        recording: usize,
        of: fn(&Fold) -> &Vec<Part>,
    ) -> impl Iterator<Item = (usize, Range<usize>)> + '_ {
        self.folds.iter().enumerate().flat_map(move |(fold, rows)| {
            let own = of(rows).iter().filter(move |part| part.0 == recording);
            own.map(move |part| (fold, part.1.clone()))
        })
    }

    /// The design in numbers.
    pub fn report(&self) -> DesignReport {
        let rows = |of: fn(&Fold) -> &Vec<Part>| -> usize {
            let parts = self.folds.iter().flat_map(of);
            parts.map(|part| part.1.len()).sum()
        };
        let evaluated: HashSet<usize> =
            self.folds.iter().flat_map(|fold| &fold.evaluated).map(|part| part.0).collect();
        DesignReport {
            description: self.description.clone(),
            split: self.split,
            folds: self.folds.len(),
            trials: evaluated.len(),
            rows: rows(|fold| &fold.evaluated),
            trained_on_rows: rows(|fold| &fold.trained_on),
            fitted_rows: rows(|fold| &fold.fitted),
            units: self.units.clone(),
        }
    }
}

/// The evaluated rows, for reports.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DesignReport {
    /// Description.
    pub description: String,
    /// The split, if one was requested.
    pub split: Option<Split>,
    /// Number of folds. 1 if evaluated and fitted rows are disjoint as a whole.
    pub folds: usize,
    /// Trials with evaluated rows.
    pub trials: usize,
    /// Evaluated rows.
    pub rows: usize,
    /// Rows that a model was trained on, scored apart.
    pub trained_on_rows: usize,
    /// Rows that baselines are fitted on, summed over the folds.
    pub fitted_rows: usize,
    /// Names of the evaluated units.
    pub units: Vec<String>,
}

fn infos(recordings: &[Recording]) -> Vec<SourceInfo> {
    recordings.iter().map(Recording::info).collect()
}

fn names(recordings: &[Recording]) -> Vec<String> {
    let names = recordings.iter().map(|recording| recording.name.clone());
    names.collect()
}

/// Leave-one-fold-out: every recording is evaluated once, with all other folds fitted on.
fn in_turn(recordings: &[Recording], count: usize) -> Vec<Fold> {
    let mut folds = vec![Fold::default(); count];
    let (mut first_with, mut first_of) = (HashMap::new(), HashMap::new());
    for (at, recording) in recordings.iter().enumerate() {
        let whole = (at, 0..recording.rows());
        let info = recording.info();
        // The parts of a long recording stay together.
        let unit = first_of.len();
        let unit = *first_of.entry((info.trial, info.robot)).or_insert(unit);
        let first = *first_with.entry(recording.digest()).or_insert(unit);
        for (number, fold) in folds.iter_mut().enumerate() {
            if number == first % count {
                fold.evaluated.push(whole.clone());
            } else {
                fold.fitted.push(whole.clone());
            }
        }
    }
    folds
}

/// The earlier parts of a long recording, and the later ones.
fn in_two(recordings: &[Recording]) -> Vec<Fold> {
    let parts: Vec<_> = recordings.iter().map(|part| 0..part.rows()).enumerate().collect();
    let (earlier, later) = parts.split_at(parts.len() / 2);
    let fold = |evaluated: &[(usize, Range<usize>)], fitted: &[(usize, Range<usize>)]| Fold {
        evaluated: evaluated.to_vec(),
        fitted: fitted.to_vec(),
        trained_on: Vec::new(),
    };
    vec![fold(earlier, later), fold(later, earlier)]
}

/// Two halves that share no reading.
fn in_halves(rows: usize) -> Vec<Fold> {
    let middle = rows / 2;
    let (first, second) = (0..middle, middle..rows);
    let (until, from) = (middle.saturating_sub(PAUSE_ROWS), (middle + PAUSE_ROWS).min(rows));
    let fold = |evaluated: Range<usize>, fitted: Range<usize>| Fold {
        evaluated: vec![(0, evaluated)],
        fitted: vec![(0, fitted)],
        trained_on: Vec::new(),
    };
    vec![fold(first, from..rows), fold(second, 0..until)]
}

/// The linear models of each fold. `None` if one could not be fitted.
pub(super) type Lines = [Vec<Option<Linear>>];

/// The baselines of each fold: `lines[fold][i]` is `baselines[i]`, `None` if there are too few rows
/// to fit it on.
///
/// # Errors
/// [`ScoreError::Design`]: the design belongs to other recordings.
pub(super) fn fit_lines(
    design: &Design,
    recordings: &[Recording],
    baselines: &[Terms],
) -> Result<Vec<Vec<Option<Linear>>>, ScoreError> {
    let fitted = Fitted::new(design, recordings)?;
    let terms = fitted.terms(baselines)?;
    let moments = fitted.map(!baselines.is_empty(), |rows, part| -> Vec<Moments> {
        let each = terms.iter().map(|(known, _)| Moments::of(&rows.rows[part.clone()], *known));
        each.collect()
    })?;
    let mut lines = vec![Vec::new(); design.folds.len()];
    for (at, (&asked, (known, missing))) in baselines.iter().zip(&terms).enumerate() {
        for (fold, lines) in design.folds.iter().zip(&mut lines) {
            let mut merged = Moments::new(*known);
            for place in fold.fitted.iter().filter_map(|part| fitted.place(part)) {
                merged.merge(&moments[place][at])?;
            }
            let mut line = merged.fit(*known).ok();
            if let Some(line) = &mut line {
                line.miss(asked, missing);
            }
            lines.push(line);
        }
    }
    Ok(lines)
}

/// Fits the references in each fold.
///
/// # Errors
/// As [`fit_lines`].
pub(super) fn fit_references(
    design: &Design,
    recordings: &[Recording],
    references: &[Reference],
) -> Result<Vec<Vec<Learned>>, ScoreError> {
    let fitted = Fitted::new(design, recordings)?;
    let parts = |fold: &Fold| -> Vec<usize> {
        fold.fitted.iter().filter_map(|part| fitted.place(part)).collect()
    };
    let mut learned = vec![Vec::new(); design.folds.len()];
    for reference in references {
        let of_folds: Vec<Learned> = match reference {
            Reference::Ridge(terms) => {
                let known = fitted.terms(&[*terms])?;
                let [(known, missing)] = known.as_slice() else {
                    continue;
                };
                let moments =
                    fitted.map(true, |rows, part| Moments::of(&rows.rows[part], *known))?;
                let of_fold = |fold| {
                    let own: Vec<&Moments> = parts(fold).iter().map(|at| &moments[*at]).collect();
                    let mut line = Moments::fit_ridge(&own, *known).ok();
                    if let Some(line) = &mut line {
                        line.miss(*terms, missing);
                    }
                    Learned::Ridge(line)
                };
                design.folds.iter().map(of_fold).collect()
            }
            Reference::Mean | Reference::Foreign(_) => vec![Learned::Nothing; design.folds.len()],
        };
        learned.iter_mut().zip(of_folds).for_each(|(fold, one)| fold.push(one));
    }
    Ok(learned)
}

const fn key(part: &Part) -> (usize, usize, usize) {
    (part.0, part.1.start, part.1.end)
}

/// The rows on which baselines are fitted.
struct Fitted<'a> {
    /// Evaluated recordings, and those used only for fitting.
    all: Vec<&'a Recording>,
    /// In ascending order, each once.
    parts: Vec<&'a Part>,
}

impl<'a> Fitted<'a> {
    /// Parts are computed once, because folds share most of them.
    fn new(design: &'a Design, recordings: &'a [Recording]) -> Result<Self, ScoreError> {
        design.check(recordings)?;
        let mut parts: Vec<&Part> = design.folds.iter().flat_map(|fold| &fold.fitted).collect();
        parts.sort_unstable_by_key(|part| key(part));
        parts.dedup();
        Ok(Self { all: recordings.iter().chain(&design.others).collect(), parts })
    }

    /// The known ones of some terms, and the positions of the others.
    fn terms(&self, asked: &[Terms]) -> Result<Vec<(Terms, Vec<usize>)>, ScoreError> {
        let any = asked.iter().fold(Terms::new(&[]), |any, terms| any.or(*terms));
        let known =
            self.map(any.count() > 0, |rows, part| KnownFeatures::new(&rows.rows[part], any))?;
        let known = known.into_iter().fold(KnownFeatures::NONE, KnownFeatures::or);
        Ok(asked.iter().map(|terms| known.split(*terms)).collect())
    }

    fn place(&self, part: &Part) -> Option<usize> {
        let found = self.parts.binary_search_by_key(&key(part), |part| key(part));
        found.ok()
    }

    /// The results of `of` for the rows of each part, in order. Reads nothing unless `wanted`.
    fn map<T: Send>(
        &self,
        wanted: bool,
        of: impl Fn(&TrialRows, Range<usize>) -> T + Sync,
    ) -> Result<Vec<T>, ScoreError> {
        if !wanted {
            return Ok(Vec::new());
        }
        let by_recording: Vec<&[&Part]> = self.parts.chunk_by(|a, b| a.0 == b.0).collect();
        let recordings: Vec<&Recording> = by_recording
            .iter()
            .filter_map(|parts| self.all.get(parts.first()?.0).copied())
            .collect();
        let mut found = Vec::with_capacity(self.parts.len());
        each(
            &recordings,
            |at| {
                let contents = recordings[at].contents()?;
                let parts = by_recording[at].iter();
                let parts = parts.map(|part| of(&contents.rows, part.1.clone()));
                Ok::<_, ScoreError>(parts.collect::<Vec<T>>())
            },
            |_, of_parts| {
                found.extend(of_parts);
                Ok(())
            },
        )?;
        Ok(found)
    }
}
