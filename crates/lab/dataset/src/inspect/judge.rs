//! Judges whether a trial's readings are plausible.

use std::collections::BTreeMap;

use joulebus_plausibility::{Edit, Finding, Judge, Kind, Known, Observation, Origin, Rows};
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
    judge_from(Origin::Recording, trial, limits)
}

/// Same as [`judge`], with the remedies of another source.
pub fn judge_from(origin: Origin, trial: &Trial, limits: &Limits) -> Vec<Implausible> {
    let known = known(trial, limits);
    let mut judge = Judge::new(known);
    trial.observations().for_each(|seen| judge.take(&seen));
    let appended = trial.appended().map(|begun| Finding::appended(begun.row, begun.back_s));
    let all = judge.findings();
    let origin = match origin {
        Origin::Recording if trial.is_turned() => Origin::TurnedRecording,
        Origin::Recording if trial.is_array() => Origin::Array,
        Origin::Bag if trial.is_turned() => Origin::TurnedBag,
        origin => origin,
    };
    let rows = Rows::new(trial.observations(), known, is_product(origin, trial));
    let found = all.iter().cloned().chain(appended).chain(unread(trial));
    found
        .map(|finding| {
            let edits = rows.working(&finding, &all, |of| name_in(origin, trial, of));
            implausible(origin, trial, finding, &edits)
        })
        .collect()
}

/// True if its power is made of voltage and current.
fn is_product(origin: Origin, trial: &Trial) -> bool {
    let mut sources = trial.sources().iter();
    let is_of_table = !trial.sources().is_empty();
    matches!(origin, Origin::Bag | Origin::TurnedBag)
        || (is_of_table && !sources.any(|source| source.column == Column::Power))
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

/// The name of a finding's quantity in its source, whose end may state the unit. Messages of a bag
/// have SI units.
fn name_in(origin: Origin, trial: &Trial, finding: &Finding) -> Option<String> {
    name(trial, finding).filter(|_| !matches!(origin, Origin::Bag | Origin::TurnedBag))
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
    let mut groups = BTreeMap::<_, Vec<&Trial>>::new();
    for trial in trials.into_iter().filter(|trial| is_short(trial)) {
        let names: Vec<&str> = trial.sources().iter().map(|one| one.name.as_str()).collect();
        groups.entry((trial.path().parent(), names)).or_default().push(trial);
    }
    let several = groups.into_values().filter(|trials| trials.len() > 1);
    several.flat_map(|trials| of_group(&trials, &TOGETHER)).collect()
}

fn of_group(trials: &[&Trial], kinds: &[Kind]) -> Vec<Implausible> {
    let first = trials[0];
    let known = known(first, &Limits::default());
    let mut judge = Judge::new(known);
    for trial in trials {
        judge.begin();
        trial.observations().for_each(|seen| judge.take(&seen));
    }
    let rows = trials.iter().scan(0.0, |next_s, trial| {
        let begun_s = *next_s;
        let times_s = trial.timestamp_s();
        *next_s += times_s[times_s.len() - 1] - times_s[0] + 1.0;
        let later = move |seen: Observation| Observation { time_s: seen.time_s + begun_s, ..seen };
        Some(trial.observations().map(later))
    });
    let origin = Origin::Recording;
    let rows = Rows::new(rows.flatten(), known, is_product(origin, first));
    let (count, all) = (trials.len(), judge.findings());
    let found = all.iter().filter(|finding| kinds.contains(&finding.kind)).cloned();
    found
        .map(|mut finding| {
            let edits = rows.working(&finding, &all, |of| name_in(origin, first, of));
            finding.found = format!("{count} short recordings as one: {}", finding.found);
            implausible(origin, first, finding, &edits)
        })
        .collect()
}

fn implausible(origin: Origin, trial: &Trial, finding: Finding, edits: &[Edit]) -> Implausible {
    let name = name(trial, &finding);
    let named = match finding.kind {
        Kind::Sources => trial.apart(),
        _ => name.as_deref().or_else(|| trial.time_name()),
    };
    let remedy = finding.remedy_by(origin, named, edits);
    let robot = trial.robot_name().map(|robot| format!("robot {robot}: ")).unwrap_or_default();
    let what = format!("{robot}{}", finding.sentences(&remedy));
    let place = Occurrence { file: trial.path().to_owned(), row: None, column: name, what };
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
