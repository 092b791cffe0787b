//! Judges whether a trial's readings are plausible.

use std::collections::BTreeMap;

use joulebus_plausibility::{Edit, Finding, Judge, Kind, Known, Source, TimeUnit};
use serde::Serialize;

use super::finding::Occurrence;
use super::limits::Limits;
use crate::trial::{Column, JUDGED, Trial, command_option};

/// Something implausible in a trial.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Implausible {
    /// The finding.
    #[serde(flatten)]
    pub finding: Finding,
    /// The remedy.
    pub remedy: String,
    /// The file, and the column in it.
    #[serde(flatten)]
    pub place: Occurrence,
}

/// Judges a trial by all its rows: what is implausible, errors first.
pub fn judge(trial: &Trial, limits: &Limits) -> Vec<Implausible> {
    judge_from(Source::Recording, trial, limits)
}

/// Same as [`judge`], with the remedies of another source.
pub fn judge_from(source: Source, trial: &Trial, limits: &Limits) -> Vec<Implausible> {
    let mut judge = Judge::new(known(trial, limits));
    take(&mut judge, trial);
    let appended = trial.appended().map(|begun| Finding::appended(begun.row, begun.back_s));
    let all = judge.findings();
    let found = all.iter().cloned().chain(appended).chain(unread(trial));
    found
        .map(|finding| implausible(source, trial, finding, &Trials { trial, limits, all: &all }))
        .collect()
}

/// A column that looks like a command, where the file has no other one.
fn unread(trial: &Trial) -> Option<Finding> {
    let [reads_v, reads_omega] =
        [Column::V, Column::Omega].map(|column| trial.column(column).is_some());
    let ignored = trial.notes().ignored_columns.iter();
    let mut options =
        ignored.filter_map(|name| Some((name, command_option(name, reads_v, reads_omega)?)));
    let (name, option) = options.next()?;
    Some(Finding::unread(name, &option, trial.rows() as u64))
}

/// What remedies are tried on.
struct Trials<'a> {
    trial: &'a Trial,
    limits: &'a Limits,
    /// All findings without them.
    all: &'a [Finding],
}

/// Edits of other findings that are tried together with one.
const MAX_TOGETHER: usize = 8;

impl Trials<'_> {
    /// The edits of a finding that leave it no more, and no other error that was not there: by
    /// themselves, or with those of the other findings.
    fn working(&self, finding: &Finding) -> Vec<Edit> {
        let edits = |of: &Finding| of.edits(name(self.trial, of).as_deref());
        let others = self.all.iter().filter(|other| !is_same(other, finding));
        let mut together: Vec<Vec<Edit>> = vec![Vec::new()];
        for candidates in others.map(edits).filter(|edits| !edits.is_empty()) {
            let with = together.iter().flat_map(|before| {
                candidates
                    .iter()
                    .map(|edit| [before.as_slice(), std::slice::from_ref(edit)].concat())
            });
            let with: Vec<Vec<Edit>> = with.collect();
            together.extend(with);
            together.truncate(MAX_TOGETHER);
        }
        let works = |edit: &Edit| {
            together.iter().any(|others| {
                let edits = [std::slice::from_ref(edit), others.as_slice()].concat();
                let left = self.judged(&edits);
                let is_new = |left: &Finding| {
                    left.is_error() && !self.all.iter().any(|before| is_same(before, left))
                };
                !left.iter().any(|left| is_same(left, finding) || is_new(left))
            })
        };
        edits(finding).into_iter().filter(works).collect()
    }

    /// Findings with edits.
    fn judged(&self, edits: &[Edit]) -> Vec<Finding> {
        let trial = self.trial;
        let mut known = known(trial, self.limits);
        for edit in edits {
            match edit {
                Edit::Unit { quantity, .. } => known = known.stated(*quantity),
                Edit::Time { .. } => known = known.timed(TimeUnit::Named),
                Edit::Turn => known = known.turned(!trial.is_turned()),
                _ => {}
            }
        }
        let has_power = trial.sources().iter().any(|source| source.column == Column::Power);
        let is_product = !trial.sources().is_empty() && !has_power;
        let products = trial.observations().map(|seen| seen.power_w * seen.current_a);
        let turns_power = products.filter(|product| !product.is_nan()).sum::<f64>() >= 0.0;
        let mut judge = Judge::new(known);
        for mut seen in trial.observations() {
            edits.iter().for_each(|edit| edit.apply(&mut seen, turns_power, is_product));
            judge.take(&seen);
        }
        judge.findings()
    }
}

fn is_same(one: &Finding, other: &Finding) -> bool {
    (one.kind, one.quantity) == (other.kind, other.quantity)
}

/// The name of the column of a finding's quantity.
fn name(trial: &Trial, finding: &Finding) -> Option<String> {
    let column = finding.quantity.and_then(|quantity| {
        let judged = JUDGED.iter().find(|(of, _)| *of == quantity);
        judged.map(|(_, column)| *column)
    });
    column.map(|column| trial.name_of(column).to_owned())
}

/// Rows of a trial that has too few to be judged by itself.
const SHORT_ROWS: usize = 100;

/// True if a trial has so few rows that it is judged with the others of its folder as well.
pub fn is_short(trial: &Trial) -> bool {
    trial.rows() < SHORT_ROWS
}

/// Judges the short ones among trials as one recording, with those of the same folder and columns:
/// sign, unit, missing readings, and power beside voltage and current. The first of them names it.
pub fn judge_together<'a>(trials: impl IntoIterator<Item = &'a Trial>) -> Vec<Implausible> {
    const TOGETHER: [Kind; 4] = [Kind::Sign, Kind::Unit, Kind::Sentinel, Kind::Mismatch];
    let mut groups = BTreeMap::<_, (Judge, &Trial, usize)>::new();
    for trial in trials.into_iter().filter(|trial| is_short(trial)) {
        let names: Vec<&str> = trial.sources().iter().map(|one| one.name.as_str()).collect();
        let new = || (Judge::new(known(trial, &Limits::default())), trial, 0);
        let (judge, _, count) = groups.entry((trial.path().parent(), names)).or_insert_with(new);
        judge.begin();
        take(judge, trial);
        *count += 1;
    }
    let several = groups.into_values().filter(|(_, _, count)| *count > 1);
    let found = several.flat_map(|(judge, first, count)| {
        let found = judge.findings().into_iter();
        let found = found.filter(|finding| TOGETHER.contains(&finding.kind));
        found.map(move |mut finding| {
            finding.found = format!("{count} short recordings as one: {}", finding.found);
            let trials = Trials { trial: first, limits: &Limits::default(), all: &[] };
            implausible(Source::Recording, first, finding, &trials)
        })
    });
    found.collect()
}

/// Gives a judge the rows of a trial.
fn take(judge: &mut Judge, trial: &Trial) {
    trial.observations().for_each(|seen| judge.take(&seen));
}

fn implausible(from: Source, trial: &Trial, finding: Finding, trials: &Trials<'_>) -> Implausible {
    let name = name(trial, &finding);
    let from = match from {
        Source::Recording if trial.is_turned() => Source::TurnedRecording,
        Source::Recording if trial.is_array() => Source::Array,
        from => from,
    };
    let named = match finding.kind {
        Kind::Sources => trial.apart(),
        _ => name.as_deref().or_else(|| trial.time_name()),
    };
    let remedy = finding.remedy_by(from, named, &trials.working(&finding));
    let robot = trial.robot_name().map(|robot| format!("robot {robot}: ")).unwrap_or_default();
    let place = Occurrence {
        file: trial.path().to_owned(),
        row: None,
        column: name,
        what: format!("{robot}{}", finding.sentences(&remedy)),
    };
    Implausible { finding, remedy, place }
}

fn known(trial: &Trial, limits: &Limits) -> Known {
    let mut known = trial.known();
    for (quantity, column) in JUDGED {
        if let Some(range) = limits.range(column) {
            known = known.within(quantity, range.least, range.greatest);
        }
    }
    known
}
