//! The times of a text's rows.

use std::ops::RangeInclusive;
use std::path::Path;

use csv::ByteRecord;
use joulebus_plausibility::moment::{self, Midnights, TimeForm};

use super::TrialError;
use super::names::Found;
use super::numbers::Numbers;
use super::table::{Cell, Table, is_time};

/// The columns with the time of a row.
#[derive(Debug, Clone, Copy)]
pub(super) enum TimeColumns {
    One(Found),
    /// Seconds and nanoseconds.
    Pair(usize, usize),
    /// A date, and a time of day.
    Dated(usize, usize),
    /// A time whose fraction stands in the field behind it, because both have commas.
    Split(usize),
}

/// Form of the times of a text.
#[derive(Debug, Default)]
pub(super) struct Times {
    pub(super) form: Option<TimeForm>,
    /// Whether the day is first in dates with slashes.
    day_first: Option<bool>,
    /// True if they are numbers of a unit that their size shows, when all are known.
    pub(super) is_epoch: bool,
    /// This unit, and how many make a second.
    unit: Option<(&'static str, f64)>,
    /// True if they are whole numbers, and nothing states their unit.
    is_unstated: bool,
    /// True if they are numbers of few digits with an exponent.
    is_shortened: bool,
    /// State of the times of day, over all robots.
    midnights: Midnights,
}

/// Units of times since 1970, with their number in a second.
const EPOCHS: [(&str, f64); 3] =
    [("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9)];
/// Times that may be taken for such: the years 1997 to 2096.
const MIN_EPOCH_S: f64 = 8.6e8;
const MAX_EPOCH_S: f64 = 4e9;
/// Longer steps are those of another unit.
const MAX_STEP_S: f64 = 3600.0;
/// Digits of a number that a spreadsheet shortens.
const SHORT_DIGITS: usize = 7;
/// Steps of whole numbers that may be seconds or milliseconds.
const EITHER_S: RangeInclusive<f64> = 2.0..=20.0;

impl Times {
    /// Of texts in which the day is first in dates with slashes, or not, if that is known.
    pub(super) fn new(day_first: Option<bool>) -> Self {
        Self { day_first, ..Self::default() }
    }

    /// The time in a row, s, or in a unit that is not known yet.
    pub(super) fn take(
        &mut self,
        cell: Cell<'_>,
        (columns, name): (TimeColumns, &str),
        record: &ByteRecord,
        numbers: &mut Numbers,
    ) -> Result<f64, TrialError> {
        let field = |position: usize| record.get(position).unwrap_or_default();
        let refuse = |field: &[u8], allowed: &str| {
            let found = String::from_utf8_lossy(field);
            cell.refuse(name, found.chars().take(60).collect::<String>(), allowed)
        };
        let allowed =
            || format!("a number of seconds within ±4e9, or a time such as {}", moment::ALLOWED);
        let joined = |first: usize, between: &[u8], second: usize| {
            [field(first), between, field(second)].concat()
        };
        let is_number_allowed = matches!(columns, TimeColumns::One(_));
        let (text, factor, states_unit) = match columns {
            TimeColumns::One(found) => {
                (field(found.position).to_vec(), found.factor, found.states_unit)
            }
            TimeColumns::Dated(date, clock) => (joined(date, b" ", clock), 1.0, true),
            TimeColumns::Split(position) => (joined(position, b",", position + 1), 1.0, true),
            TimeColumns::Pair(seconds, nanoseconds) => {
                let mut part = |position| {
                    let found = numbers.parse(field(position));
                    found.map_err(|allowed| refuse(field(position), allowed))
                };
                let time_s = part(seconds)? + part(nanoseconds)? * 1e-9;
                return match is_time(time_s) {
                    true => Ok(time_s),
                    false => Err(refuse(field(seconds), &allowed())),
                };
            }
        };
        let (form, time_s) = match numbers.parse(&text).ok().filter(|_| is_number_allowed) {
            Some(number) => (TimeForm::Number, number * factor),
            None => {
                let parsed = std::str::from_utf8(&text).ok();
                let parsed = parsed.and_then(|text| moment::parse(text, self.day_first));
                parsed.ok_or_else(|| refuse(&text, &allowed()))?
            }
        };
        let is_first = self.form.is_none();
        if *self.form.get_or_insert(form) != form {
            return Err(refuse(&text, "a time that is written as in the first row"));
        }
        if is_first && form == TimeForm::Number {
            self.is_shortened = true;
            if !states_unit {
                self.is_epoch = time_s.abs() >= EPOCHS[0].1 * MIN_EPOCH_S;
                self.is_unstated = true;
            }
        }
        self.is_unstated &= time_s.fract() == 0.0;
        let mantissa = text.iter().position(|byte| byte.eq_ignore_ascii_case(&b'e'));
        self.is_shortened &= mantissa.is_some_and(|length| length <= SHORT_DIGITS + 2);
        match is_time(time_s) || (self.is_epoch && time_s.is_finite()) {
            true if matches!(form, TimeForm::Clock | TimeForm::Minutes) => {
                Ok(self.midnights.take(form, time_s))
            }
            true => Ok(time_s),
            false => Err(cell.refuse(name, String::from_utf8_lossy(&text), many_seconds(name))),
        }
    }

    /// Turns the times of tables into seconds, in the unit of the first ones.
    pub(super) fn finish(
        &mut self,
        path: &Path,
        tables: &mut [Table],
        name: &str,
        understood: &mut Vec<String>,
    ) -> Result<(), TrialError> {
        let row = Cell { path, row: tables.first().map_or(1, |table| table.file_row(0)) };
        if self.is_shortened {
            let mut times: Vec<f64> =
                tables.iter().flat_map(|table| table.timestamp_s.iter().copied()).collect();
            let rows = times.len();
            times.sort_unstable_by(f64::total_cmp);
            times.dedup();
            if 2 * times.len() <= rows {
                let found = format!("{} different times in {rows} rows", times.len());
                let allowed = "times with all their digits, which a spreadsheet has shortened: \
                    give the column a format such as 0.000, and save it again";
                return Err(row.refuse(name, found, allowed));
            }
        }
        // Newest first, they descend.
        let steps = tables.iter().filter_map(|table| {
            let pairs = table.timestamp_s.windows(2);
            let steps = pairs.map(|pair| (pair[1] - pair[0]).abs());
            let mut steps: Vec<f64> = steps.filter(|step| *step > 0.0).collect();
            let middle = steps.len().checked_sub(1)? / 2;
            Some(*steps.select_nth_unstable_by(middle, f64::total_cmp).1)
        });
        let step = steps.reduce(f64::min).unwrap_or_default();
        // millis() of an Arduino at 50 to 500 Hz.
        if self.is_unstated && !self.is_epoch && EITHER_S.contains(&step) {
            let found = format!("whole numbers that are usually {step} apart");
            return Err(row.refuse(name, found, either(name)));
        }
        if self.is_epoch {
            let all = || tables.iter().flat_map(|table| table.timestamp_s.iter().copied());
            let of_unit = |(_, per_second): &(&str, f64)| {
                let mut times_s = all().map(|time| time / per_second);
                step / per_second <= MAX_STEP_S
                    && times_s.all(|time_s| (MIN_EPOCH_S..MAX_EPOCH_S).contains(&time_s))
            };
            let found = match self.unit {
                Some(unit) => Some(unit).filter(of_unit),
                None => EPOCHS.into_iter().find(of_unit),
            };
            let Some((unit, per_second)) = found else {
                let found = all().next().unwrap_or_default().to_string();
                return Err(row.refuse(name, found, many_seconds(name)));
            };
            for time in tables.iter_mut().flat_map(|table| &mut table.timestamp_s) {
                *time /= per_second;
            }
            if self.unit.replace((unit, per_second)).is_none() {
                understood.push(format!("{name} is read as {unit} since 1970"));
            }
        }
        Ok(())
    }

    pub(super) fn note(&self, name: &str, understood: &mut Vec<String>) {
        understood.extend(self.midnights.note(name));
        let day_first = self.day_first.filter(|_| self.form == Some(TimeForm::Date));
        understood.extend(day_first.map(|day_first| {
            let order = if day_first { "day, month and year" } else { "month, day and year" };
            format!("the dates of {name} are {order}")
        }));
    }
}

fn either(name: &str) -> String {
    format!(
        "a unit that is stated, because these can be seconds or milliseconds: --map time_s={name}, or --map \
         time_ms={name}"
    )
}

fn many_seconds(name: &str) -> String {
    format!(
        "a number of seconds within ±4e9. If it counts milliseconds, --map time_ms={name}, and \
            time_us or time_ns for \
         smaller ones"
    )
}
