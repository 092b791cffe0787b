//! Judges whether a trial's readings are plausible.

use std::collections::BTreeMap;

use joulebus_plausibility::{Finding, Judge, Kind, Known, Observation, Quantity, Source, TimeUnit};
use serde::Serialize;

use super::finding::Occurrence;
use super::limits::Limits;
use crate::trial::{Column, Trial};

/// The columns that are judged.
const JUDGED: [(Quantity, Column); 6] = [
    (Quantity::Power, Column::Power),
    (Quantity::Voltage, Column::Voltage),
    (Quantity::Current, Column::Current),
    (Quantity::Soc, Column::Soc),
    (Quantity::V, Column::V),
    (Quantity::Omega, Column::Omega),
];

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
    let found = judge.findings().into_iter().chain(appended);
    found.map(|finding| implausible(source, trial, finding)).collect()
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
            implausible(Source::Recording, first, finding)
        })
    });
    found.collect()
}

/// Gives a judge the rows of a trial.
fn take(judge: &mut Judge, trial: &Trial) {
    let value = |column, row: usize| trial.column(column).map_or(f64::NAN, |values| values[row]);
    let first_s = trial.timestamp_s().first().copied().unwrap_or_default();
    for (row, time_s) in trial.timestamp_s().iter().enumerate() {
        judge.take(&Observation {
            time_s: time_s - first_s,
            v_mps: value(Column::V, row),
            omega_radps: value(Column::Omega, row),
            v_measured_mps: value(Column::VMeasured, row),
            omega_measured_radps: value(Column::OmegaMeasured, row),
            power_w: value(Column::Power, row),
            voltage_v: value(Column::Voltage, row),
            current_a: value(Column::Current, row),
            soc: value(Column::Soc, row),
            charging: None,
        });
    }
}

fn implausible(from: Source, trial: &Trial, finding: Finding) -> Implausible {
    let column = finding.quantity.and_then(|quantity| {
        let judged = JUDGED.iter().find(|(of, _)| *of == quantity);
        judged.map(|(_, column)| *column)
    });
    let name = column.map(|column| trial.name_of(column).to_owned());
    let from = match from {
        Source::Recording if trial.is_turned() => Source::TurnedRecording,
        Source::Recording if is_array(trial) => Source::Array,
        from => from,
    };
    let named = name.as_deref().or_else(|| trial.time_name());
    let remedy = finding.remedy(from, named);
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
    let time = match (trial.time_name(), trial.states_time_unit()) {
        _ if is_array(trial) => TimeUnit::Unstated,
        (None, _) => TimeUnit::Certain,
        (Some(_), true) => TimeUnit::Named,
        (Some(_), false) => TimeUnit::Unstated,
    };
    let mut known = Known::default().whole().timed(time).turned(trial.is_turned());
    for (quantity, column) in JUDGED {
        if let Some(range) = limits.range(column) {
            known = known.within(quantity, range.least, range.greatest);
        }
        let source = trial.sources().iter().find(|source| source.column == column);
        if source.is_some_and(|source| !source.states_unit) {
            known = known.unstated(quantity);
        }
        if source.is_some_and(|source| source.is_mapped) {
            known = known.expects(quantity);
        }
    }
    known
}

/// True if its file is an array, whose columns have no names.
fn is_array(trial: &Trial) -> bool {
    trial.sources().is_empty() && joulebus_files::ends_in(trial.path(), "npy")
}
