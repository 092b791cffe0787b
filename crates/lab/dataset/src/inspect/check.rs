//! Faults of recordings, counted, with their first occurrences.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::{Path, PathBuf};

use hmac_sha256::Hash as Sha256;
use joulebus_plausibility::{Finding as Judged, Kind, Quantity, Severity};
use rayon::iter::{IntoParallelRefIterator as _, ParallelIterator as _};
use serde::Serialize;

use super::constant::only_value;
use super::finding::{Finding, FindingKind, Occurrence};
use super::hold::runs;
use super::judge::{is_short, judge, judge_together};
use super::limits::Limits;
use super::units::power_check;
use crate::trial::{Column, ColumnMap, Trial, TrialError};

/// Result of checking a set of files.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Check {
    /// Files checked.
    pub files: usize,
    /// Trials in them: one per robot and file.
    pub trials: usize,
    /// Distinct robot names.
    pub robots: usize,
    /// Rows of the trials.
    pub rows: usize,
    /// Number of faults.
    pub faults: usize,
    /// All findings, faults first, one per kind.
    pub findings: Vec<Finding>,
}

impl Check {
    /// True if there is no fault.
    pub const fn is_sound(&self) -> bool {
        self.faults == 0
    }

    /// Lets findings through: they are no faults any more.
    pub fn accept(&mut self, kinds: &[Kind]) {
        for finding in &mut self.findings {
            let is_accepted = kinds.iter().any(|kind| finding.kind.is_of(*kind));
            if finding.fault && is_accepted {
                (finding.fault, finding.accepted) = (false, true);
                self.faults -= finding.count;
            }
        }
        self.findings.sort_by_key(|finding| !finding.fault);
    }

    /// The finding of a kind, if there is one.
    pub fn finding(&self, kind: FindingKind) -> Option<&Finding> {
        self.findings.iter().find(|finding| finding.kind == kind)
    }
}

/// Checks files in parallel. A file that cannot be read is a finding, not an error. Of each kind,
/// `places` occurrences are kept, in the order of the files and rows. The result is the same for
/// any number of threads.
pub fn check_files(files: &[PathBuf], map: &ColumnMap, limits: &Limits, places: usize) -> Check {
    let looked: Vec<Looked> =
        files.par_iter().map(|file| look(file, map, limits, places)).collect();
    let mut all = Findings::new(places);
    let mut first_with = HashMap::new();
    for (file, looked) in files.iter().zip(&looked) {
        for finding in &looked.findings {
            all.merge(finding);
        }
        for digest in &looked.digests {
            if let Some(first) = first_with.insert(*digest, file) {
                let what = format!("the rows of {}", first.display());
                all.merge(&single(FindingKind::Copy, file, what));
                first_with.insert(*digest, first);
            }
        }
    }
    // What no short recording shows by itself.
    for together in judge_together(looked.iter().flat_map(|looked| &looked.short)) {
        let kind = FindingKind::judged(together.finding.kind);
        if let Some(kind) = kind.filter(|kind| !all.kinds.contains_key(kind)) {
            let mut finding = single(kind, &together.place.file, String::new());
            finding.places = vec![together.place];
            all.merge(&finding);
        }
    }
    let names = looked.iter().flat_map(|looked| &looked.robots);
    let findings = all.finish();
    Check {
        files: files.len(),
        trials: looked.iter().map(|looked| looked.digests.len()).sum(),
        robots: names.collect::<BTreeSet<_>>().len(),
        rows: looked.iter().map(|looked| looked.rows).sum(),
        faults: findings.iter().filter(|finding| finding.fault).map(|finding| finding.count).sum(),
        findings,
    }
}

/// Result for one file.
#[derive(Default)]
struct Looked {
    findings: Vec<Finding>,
    digests: Vec<[u8; 32]>,
    robots: Vec<String>,
    rows: usize,
    short: Vec<Trial>,
}

fn look(file: &Path, map: &ColumnMap, limits: &Limits, places: usize) -> Looked {
    let read = check_robots(file, map, limits, places);
    let broken = matches!(&read, Err(error) if error.is_of_lines());
    // The other rows are checked as well.
    let whole = map.clone().whole_rows(true);
    let whole = broken.then(|| check_robots(file, &whole, limits, places).ok());
    match whole.flatten().map_or(read, Ok) {
        Err(error) => {
            let text = error.to_string();
            let prefix = format!("{}: ", file.display());
            let what = text.strip_prefix(&prefix).unwrap_or(&text).to_owned();
            Looked {
                findings: vec![single(FindingKind::Unreadable, file, what)],
                ..Looked::default()
            }
        }
        Ok(mut looked) => {
            // Left out on request.
            let findings = looked.findings.iter_mut();
            let asked = findings.filter(|finding| finding.kind == FindingKind::NoRow && !broken);
            asked.for_each(|finding| (finding.fault, finding.accepted) = (false, true));
            looked
        }
    }
}

/// The trials of one file.
fn check_robots(
    file: &Path,
    map: &ColumnMap,
    limits: &Limits,
    places: usize,
) -> Result<Looked, TrialError> {
    let (mut all, mut looked) = (Findings::new(places), Looked::default());
    Trial::each(file, map, |trial| {
        for finding in check_trial(&trial, limits, places) {
            all.merge(&finding);
        }
        looked.digests.push(digest(&trial));
        looked.robots.extend(trial.robot_name().map(str::to_owned));
        looked.rows += trial.rows();
        looked.short.extend(Some(trial).filter(is_short));
        Ok::<_, TrialError>(())
    })?;
    looked.findings = in_one_file(all.finish());
    Ok(looked)
}

fn in_one_file(mut findings: Vec<Finding>) -> Vec<Finding> {
    for finding in &mut findings {
        finding.files = 1;
    }
    findings
}

fn single(kind: FindingKind, file: &Path, what: String) -> Finding {
    let mut finding = Finding::new(kind);
    (finding.count, finding.files) = (1, 1);
    finding.places = vec![Occurrence { file: file.to_owned(), row: None, column: None, what }];
    finding
}

/// Digest of times and values. Two recordings of the same run have the same digest, whatever the
/// names of their robots.
fn digest(trial: &Trial) -> [u8; 32] {
    let mut digest = Sha256::new();
    for offset_ns in trial.offset_ns() {
        digest.update(offset_ns.to_le_bytes());
    }
    for column in Column::ALL {
        digest.update([u8::from(trial.column(column).is_some())]);
        for value in trial.column(column).unwrap_or_default() {
            digest.update(value.to_le_bytes());
        }
    }
    digest.finalize()
}

/// Findings by kind, with their first places.
struct Findings {
    places: usize,
    kinds: BTreeMap<FindingKind, Finding>,
}

impl Findings {
    const fn new(places: usize) -> Self {
        Self { places, kinds: BTreeMap::new() }
    }

    fn add(&mut self, kind: FindingKind, count: usize, place: impl FnOnce() -> Occurrence) {
        if count == 0 {
            return;
        }
        let finding = self.kinds.entry(kind).or_insert(Finding::new(kind));
        finding.count += count;
        if finding.places.len() < self.places {
            finding.places.push(place());
        }
    }

    /// Adds a finding of other files and their number.
    fn merge(&mut self, other: &Finding) {
        let finding = self.kinds.entry(other.kind).or_insert(Finding {
            fault: other.fault,
            accepted: other.accepted,
            ..Finding::new(other.kind)
        });
        finding.count += other.count;
        finding.files += other.files;
        let room = self.places.saturating_sub(finding.places.len());
        finding.places.extend(other.places.iter().take(room).cloned());
    }

    /// Faults first, each in the order of [`FindingKind`].
    fn finish(self) -> Vec<Finding> {
        let (faults, others): (Vec<_>, Vec<_>) =
            self.kinds.into_values().partition(|finding| finding.fault);
        faults.into_iter().chain(others).collect()
    }
}

/// Checks one trial. Of each kind, the first `places` occurrences are kept.
pub fn check_trial(trial: &Trial, limits: &Limits, places: usize) -> Vec<Finding> {
    let mut found = Findings::new(places);
    check_times(trial, &mut found);
    check_readings(trial, limits, &mut found);
    check_columns(trial, limits, &mut found);
    check_power(trial, limits, &mut found);
    for implausible in judge(trial, limits) {
        // What merely never changes is a note below.
        let Judged { kind, severity, .. } = &implausible.finding;
        let is_note = *kind == Kind::Constant
            && *severity == Severity::Warning
            && implausible.finding.quantity == Some(Quantity::Power);
        if let Some(kind) = FindingKind::judged(*kind).filter(|_| !is_note) {
            found.add(kind, 1, || implausible.place);
        }
    }
    check_file(trial, &mut found);
    in_one_file(found.finish())
}

fn at(trial: &Trial, row: usize, column: Option<Column>, what: String) -> Occurrence {
    Occurrence {
        file: trial.path().to_owned(),
        row: Some(trial.file_row(row)),
        column: column.map(|column| trial.name_of(column).to_owned()),
        what,
    }
}

fn whole(trial: &Trial, column: Option<Column>, what: String) -> Occurrence {
    Occurrence { row: None, ..at(trial, 0, column, what) }
}

fn check_times(trial: &Trial, found: &mut Findings) {
    let offset_ns = trial.offset_ns();
    let mut latest = 0;
    for (row, now_ns) in offset_ns.iter().enumerate().skip(1) {
        let step_ns = now_ns - offset_ns[latest];
        let (now_s, latest_row) = (trial.timestamp_s()[row], trial.file_row(latest));
        match step_ns {
            0 => found.add(FindingKind::TimeRepeated, 1, || {
                at(trial, row, None, format!("{now_s} s, as row {latest_row}"))
            }),
            ..0 => found.add(FindingKind::TimeBackward, 1, || {
                let back_s = -step_ns as f64 / 1e9;
                let what = format!("{now_s} s, {back_s:.6} s before row {latest_row}");
                at(trial, row, None, what)
            }),
            1.. => latest = row,
        }
    }
    let row_of = |file_row: usize| {
        // `file_row` increases. The notes refer to rows of the file.
        (0..trial.rows()).find(|row| trial.file_row(*row) == file_row)
    };
    for gap in &trial.notes().gaps {
        found.add(FindingKind::Gap, 1, || {
            let length_s = gap.length_ns as f64 / 1e9;
            let periods = gap.length_ns as f64 / trial.period_ns() as f64;
            let what = format!("{length_s:.3} s without a row, {periods:.1} periods");
            at(trial, row_of(gap.row).unwrap_or_default(), None, what)
        });
    }
}

fn check_readings(trial: &Trial, limits: &Limits, found: &mut Findings) {
    let runs = runs(trial);
    let mut lengths: Vec<f64> = runs.iter().map(|run| run.rows as f64).collect();
    let usual = super::units::median(&mut lengths).unwrap_or(1.0) as usize;
    let time_s = trial.timestamp_s();
    for run in &runs {
        if run.rows > 1 {
            found.add(FindingKind::Held, run.rows - 1, || {
                at(trial, run.from, None, format!("for {} rows", run.rows))
            });
        }
        let held_s = time_s[run.from + run.rows - 1] - time_s[run.from];
        if held_s > limits.stuck_s && run.rows > limits.stuck_holds * usual {
            found.add(FindingKind::Stuck, 1, || {
                let what = format!("for {held_s:.1} s, {} rows, usually {usual}", run.rows);
                at(trial, run.from, Some(Column::Power), what)
            });
        }
    }
    let power_w = trial.column(Column::Power);
    let missing = |row: &usize| power_w.is_none_or(|values| values[*row].is_nan());
    for row in (0..trial.rows()).filter(missing).filter(|row| !trial.is_on_charger(*row)) {
        found.add(FindingKind::MissingReading, 1, || {
            at(trial, row, Some(Column::Power), "not recorded".to_owned())
        });
    }
}

fn check_columns(trial: &Trial, limits: &Limits, found: &mut Findings) {
    let power_w = trial.column(Column::Power);
    let is_missing = |row: usize| power_w.is_none_or(|values| values[row].is_nan());
    for column in Column::ALL {
        let Some(values) = trial.column(column) else {
            found.add(FindingKind::MissingColumn, 1, || {
                whole(trial, Some(column), "no value in any row".to_owned())
            });
            continue;
        };
        let range = limits.range(column);
        for (row, value) in values.iter().enumerate() {
            if value.is_nan() {
                // A row without a power has its own kind, with what power is made of, and no
                // capture has the command of its first reading.
                let is_reading = column == Column::Power
                    || (matches!(column, Column::Voltage | Column::Current) && is_missing(row));
                let is_first = row == 0 && matches!(column, Column::V | Column::Omega);
                let counts = usize::from(!is_reading && !is_first);
                found.add(FindingKind::MissingValue, counts, || {
                    at(trial, row, Some(column), "not recorded".to_owned())
                });
            } else if let Some(range) = range.filter(|range| !range.holds(*value)) {
                found.add(FindingKind::OutOfRange, 1, || {
                    let what = format!(
                        "{}, allowed: {} to {}",
                        column.shown(*value),
                        range.least,
                        range.greatest
                    );
                    at(trial, row, Some(column), what)
                });
            }
        }
        if let Some(value) = only_value(trial, column) {
            found.add(FindingKind::ConstantColumn, 1, || {
                whole(trial, Some(column), format!("always {}", column.shown(value)))
            });
        }
    }
}

/// Signs are a convention, so only magnitudes are compared. If the units are wrong, every row
/// differs. That is reported once, by the unit check.
fn check_power(trial: &Trial, limits: &Limits, found: &mut Findings) {
    let columns = [Column::Power, Column::Voltage, Column::Current].map(|c| trial.column(c));
    let [Some(power_w), Some(voltage_v), Some(current_a)] = columns else {
        return;
    };
    let off = power_check(trial).map_or(0.0, |check| check.median_ratio.log10().abs());
    if off > 1.5 {
        return;
    }
    for row in 0..trial.rows() {
        let (power_w, product_w) = (power_w[row], voltage_v[row] * current_a[row]);
        let away_w = (power_w.abs() - product_w.abs()).abs();
        let allowed_w = limits.power_step_w.max(limits.power_share * product_w.abs());
        if away_w > allowed_w {
            found.add(FindingKind::PowerMismatch, 1, || {
                let what = format!("{power_w:.4} W. Voltage times current is {product_w:.4} W");
                at(trial, row, Some(Column::Power), what)
            });
        }
    }
}

fn check_file(trial: &Trial, found: &mut Findings) {
    let notes = trial.notes();
    let name = |name: &String| Occurrence {
        column: Some(name.clone()),
        ..whole(trial, None, "not read".to_owned())
    };
    for column in &notes.ignored_columns {
        found.add(FindingKind::UnknownColumn, 1, || name(column));
    }
    for understood in &notes.understood {
        found.add(FindingKind::Understood, 1, || whole(trial, None, understood.clone()));
    }
    if let Some(charged) = notes.charged() {
        found.add(FindingKind::OnCharger, notes.on_charger, || whole(trial, None, charged));
    }
    let left_out = &notes.left_out;
    for (row, what) in &left_out.first {
        found.add(FindingKind::NoRow, 1, || Occurrence {
            row: Some(*row),
            ..whole(trial, None, what.clone())
        });
    }
    let others = left_out.lines - left_out.first.len();
    found.add(FindingKind::NoRow, others, || whole(trial, None, String::new()));
    found.add(FindingKind::CutOff, usize::from(notes.no_final_line_break), || {
        let last = trial.rows() - 1;
        at(trial, last, None, "the last line has no newline".to_owned())
    });
    found.add(FindingKind::UnnamedRow, notes.unnamed_rows, || {
        let robot = trial.robot_name().unwrap_or_default();
        let what = format!("{} rows. The others name robot {robot:?}", notes.unnamed_rows);
        whole(trial, None, what)
    });
}
