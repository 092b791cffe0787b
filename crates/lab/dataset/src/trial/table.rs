//! The columns of a trial: their names, their units, and the table that both readers fill.

use std::collections::HashMap;
use std::fmt;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use joulebus_plausibility::is_charge;
use joulebus_wire::sample_flag;

use super::error::{Fault, TrialError};
use super::limits::{InMemory, MAX_FILE_ROWS, MAX_ROBOTS};

/// A column of a trial, without robot and time. Velocities are commanded if they are not said to be
/// measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(missing_docs, reason = "their names in files have the units")]
pub enum Column {
    Phase,
    V,
    Omega,
    X,
    Y,
    Theta,
    Voltage,
    Current,
    Power,
    VMeasured,
    OmegaMeasured,
    Soc,
}

/// Names and units of columns in files, in the order of [`Column`].
const NAMES: [(&str, &str); Column::ALL.len()] = [
    ("phase", "1"),
    ("v_cmd_mps", "m/s"),
    ("omega_cmd_radps", "rad/s"),
    ("x_m", "m"),
    ("y_m", "m"),
    ("theta_rad", "rad"),
    ("voltage_mV", "mV"),
    ("current_mA", "mA"),
    ("power_mW", "mW"),
    ("v_meas_mps", "m/s"),
    ("omega_meas_radps", "rad/s"),
    ("soc", "1"),
];

impl Column {
    /// All columns. The first nine are the last nine of the array layout, in its order.
    pub const ALL: [Self; 12] = [
        Self::Phase,
        Self::V,
        Self::Omega,
        Self::X,
        Self::Y,
        Self::Theta,
        Self::Voltage,
        Self::Current,
        Self::Power,
        Self::VMeasured,
        Self::OmegaMeasured,
        Self::Soc,
    ];

    /// Number of columns of the array layout: the first of [`Column::ALL`].
    pub const LAYOUT: usize = 9;

    /// Name in a CSV header, with the unit in the file.
    pub const fn name(self) -> &'static str {
        NAMES[self as usize].0
    }

    /// Unit of the values in files. `1` without one.
    pub const fn unit(self) -> &'static str {
        NAMES[self as usize].1
    }

    /// A value in SI units, with its unit.
    pub(crate) fn shown(self, value: f64) -> String {
        let unit = if self.is_milli() { &self.unit()[1..] } else { self.unit() };
        // A turned zero has a sign.
        match (value + 0.0, unit) {
            (value, "1") => value.to_string(),
            (value, unit) => format!("{value} {unit}"),
        }
    }

    /// Converts a value of a file to SI units.
    pub(super) const fn si(self, recorded: f64) -> f64 {
        if self.is_milli() { recorded / 1000.0 } else { recorded }
    }

    /// Converts a value in SI units to the unit of files.
    pub(super) const fn recorded(self, value: f64) -> f64 {
        if self.is_milli() { value * 1000.0 } else { value }
    }

    const fn is_milli(self) -> bool {
        matches!(self, Self::Voltage | Self::Current | Self::Power)
    }
}

/// A column of a CSV that was read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SourceColumn {
    /// The quantity that it holds.
    pub column: Column,
    /// Its name in the file.
    pub name: String,
    /// True if its name, or the caller, states the unit. The layout's is assumed otherwise.
    pub states_unit: bool,
    /// True if the caller named it.
    pub is_mapped: bool,
}

/// Accepted names of the robot column in a CSV.
pub(super) const ROBOT_NAMES: &[&str] = &["robot_id"];
/// Name of the column that is 1 on the charger, in a CSV that has such rows.
pub(super) const CHARGING_NAME: &str = "charging";
/// Accepted names of the time column in a CSV.
pub(super) const TIME_NAMES: &[&str] = &["timestamp_s", "timestamp"];

/// The rows of one robot as recorded in a file: in file order, in the units of the file (mV, mA,
/// mW), to the bit. [`Trial`](super::Trial) has the same in SI units.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Table {
    pub(crate) path: PathBuf,
    pub(crate) robot_name: Option<String>,
    /// File row of each row, from 1. Not contiguous if several robots share a file.
    pub(crate) file_row: Vec<u32>,
    pub(crate) timestamp_s: Vec<f64>,
    pub(crate) columns: Columns,
    pub(crate) ignored_columns: Vec<String>,
    pub(crate) no_final_line_break: bool,
    pub(crate) unnamed_rows: usize,
    /// Rows of the file on the charger, whose power was left out. Of all parts of the file.
    pub(crate) on_charger: Vec<u32>,
    pub(crate) sources: Vec<SourceColumn>,
    /// Lines of a CSV that were left out. Of several robots the first has them.
    pub(crate) left_out: LeftOut,
    /// Interpretation of the text of a CSV, where it is not usual.
    pub(crate) understood: Vec<String>,
    /// Name of the column with the time as a number, in a CSV.
    pub(crate) time_name: Option<String>,
    /// True if that name, or the caller, states its unit.
    pub(crate) states_time_unit: bool,
    pub(crate) is_turned: bool,
    /// True if its file has more rows of the robot, which are in other tables.
    pub(crate) is_part: bool,
    /// Rows of the file in which its header comes again.
    pub(crate) headers: Vec<u32>,
    /// By how much the lines of a CSV are ahead of its rows, from lines on.
    pub(crate) ahead: Arc<[(u32, u32)]>,
    /// Position of another recording that was appended to its file, if any.
    pub(crate) appended: Option<Appended>,
    /// A column of few words by which its rows alternate, as those of several sources.
    pub(crate) apart: Option<String>,
}

/// Position of a recording that was appended to a file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Appended {
    /// Its first row in the file, from 1.
    pub(crate) row: usize,
    /// The step back of the time, s. `None`: the header came again.
    pub(crate) back_s: Option<f64>,
}

/// Step back of the time that is no reordering, s: that of a bag's clock.
const SET_BACK_S: f64 = 1.0;
/// Steps back as a share of the rows: more are those of two mixed recordings.
const MAX_SET_BACK: usize = 20;
/// Ages up to which values of other rows count, s: of commands, and of measurements, as in a bag.
const COMMAND_AGE_S: f64 = joulebus_plausibility::COMMAND_HOLDS_S;
const MEASURED_AGE_S: f64 = 1.0;
/// Times that fall, and none that rises, before rows are newest first.
const MIN_FALLS: usize = 2;
/// Values of a column before it shows whether rows are sparse, and the share of them that are in
/// rows with a reading.
const MIN_SPARSE: usize = 10;
const MAX_SHARED: f64 = 0.05;

/// Lines of a CSV that are no whole rows, and were left out on request.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct LeftOut {
    /// Their number.
    pub lines: usize,
    /// The first, each with its row in the file and what it is.
    pub first: Vec<(usize, String)>,
}

impl LeftOut {
    /// Lines that are kept with a description.
    const DESCRIBED: usize = 16;

    /// True if there are none.
    pub const fn is_none(&self) -> bool {
        self.lines == 0
    }

    pub(super) fn add(&mut self, row: usize, what: String) {
        self.lines += 1;
        if self.first.len() < Self::DESCRIBED {
            self.first.push((row, what));
        }
    }
}

impl fmt::Display for LeftOut {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{} lines that are no whole rows were left out", self.lines)?;
        match self.first.first() {
            Some((row, what)) => write!(out, ", the first in row {row}: {what}"),
            None => Ok(()),
        }
    }
}

/// Values of each [`Column`], in the order of [`Column::ALL`].
pub(crate) type Columns = [Option<Vec<f64>>; Column::ALL.len()];

/// The value at `row`, if it was recorded.
pub(super) fn value(columns: &Columns, column: Column, row: usize) -> Option<f64> {
    let value = *columns[column as usize].as_ref()?.get(row)?;
    (!value.is_nan()).then_some(value)
}

/// True if the reading of `row` equals the previous row's: power, voltage and current, to the bit.
pub(super) fn is_held(columns: &Columns, row: usize) -> bool {
    let Some(before) = row.checked_sub(1) else {
        return false;
    };
    let bits = |column, row| value(columns, column, row).map(f64::to_bits);
    bits(Column::Power, row).is_some()
        && [Column::Power, Column::Voltage, Column::Current]
            .into_iter()
            .all(|column| bits(column, row) == bits(column, before))
}

/// Location of a value, for checks and their messages.
#[derive(Clone, Copy)]
pub(crate) struct Cell<'a> {
    pub(crate) path: &'a Path,
    pub(crate) row: usize,
}

impl Cell<'_> {
    pub(super) fn refuse(
        self,
        column: impl Into<String>,
        found: impl Into<String>,
        allowed: impl Into<String>,
    ) -> TrialError {
        let what = format!("column {}: found {:?}", column.into(), found.into());
        let allowed = format!(", allowed: {}", allowed.into());
        TrialError::new(self.path, Fault::Value, what).in_row(self.row).with(allowed)
    }
}

impl Table {
    /// The file that the table was read from.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The robot's name as recorded, if any: text in a CSV, a number in an array.
    pub fn robot_name(&self) -> Option<&str> {
        self.robot_name.as_deref()
    }

    /// Renames the robot.
    pub fn rename(&mut self, robot_name: &str) {
        self.robot_name = Some(robot_name.to_owned());
        self.unnamed_rows = 0;
    }

    /// Rows.
    pub fn rows(&self) -> usize {
        self.timestamp_s.len()
    }

    /// Row of the file that holds row `row` (from 0), from 1: the line of a CSV.
    pub fn file_row(&self, row: usize) -> usize {
        self.file_row.get(row).map_or(row + 1, |row| *row as usize)
    }

    /// The number of row `row` (from 0) among the rows of its file.
    pub(super) fn data_row(&self, row: usize) -> usize {
        let file_row = self.file_row(row);
        let at = self.ahead.partition_point(|(line, _)| *line as usize <= file_row);
        let ahead = at.checked_sub(1).map_or(0, |at| self.ahead[at].1);
        file_row.saturating_sub(ahead as usize)
    }

    /// True if row `row` (from 0) is on the charger.
    pub(super) fn is_on_charger(&self, row: usize) -> bool {
        let file_row = u32::try_from(self.file_row(row));
        file_row.is_ok_and(|row| self.on_charger.binary_search(&row).is_ok())
    }

    /// True if the file, a CSV, does not end with a newline.
    pub fn no_final_line_break(&self) -> bool {
        self.no_final_line_break
    }

    /// Lines of the file that were left out, because they are no whole rows.
    pub const fn left_out(&self) -> &LeftOut {
        &self.left_out
    }

    /// Interpretation of the text of a CSV, where it is not usual.
    pub fn understood(&self) -> &[String] {
        &self.understood
    }

    /// Rows without a robot name in a table that has one. All written rows name the robot.
    pub fn unnamed_rows(&self) -> usize {
        self.unnamed_rows
    }

    /// Time of each row as recorded, s. Finite.
    pub fn timestamp_s(&self) -> &[f64] {
        &self.timestamp_s
    }

    /// One value per recorded row, in the unit stated in [`Column::name`], NaN if there is none.
    /// `None` if the file has no such column.
    pub fn column(&self, column: Column) -> Option<&[f64]> {
        self.columns[column as usize].as_deref()
    }

    /// Turns the sign of the current, and of a power that has its sign: one that was made of it, or
    /// that is positive where the current is.
    pub(super) fn turn(&mut self) {
        self.is_turned = true;
        let [power, current] = [Column::Power, Column::Current].map(|column| self.column(column));
        let agrees = match (power, current) {
            (Some(power), Some(current)) => {
                let products = power.iter().zip(current).map(|(power, current)| power * current);
                products.filter(|product| !product.is_nan()).sum::<f64>() >= 0.0
            }
            _ => true,
        };
        let turned =
            if agrees { &[Column::Power, Column::Current][..] } else { &[Column::Current] };
        for column in turned {
            for value in self.columns[*column as usize].iter_mut().flatten() {
                // 0 stays 0, and NaN keeps its bits.
                if *value != 0.0 && !value.is_nan() {
                    *value = -*value;
                }
            }
        }
    }

    /// The name of a CSV's column with the time as a number.
    pub fn time_name(&self) -> Option<&str> {
        self.time_name.as_deref()
    }

    /// True if the recording states the unit of that time, by its name or by its size.
    #[must_use]
    pub const fn states_time_unit(&self) -> bool {
        self.states_time_unit
    }

    /// The columns of a CSV that were read.
    pub fn sources(&self) -> &[SourceColumn] {
        &self.sources
    }

    /// Makes the power unknown that flows into the battery, in samples on the charger.
    pub(crate) fn leave_out_charging(&mut self, flags: impl IntoIterator<Item = u32>) {
        let Some(power) = &mut self.columns[Column::Power as usize] else {
            return;
        };
        for ((power, flags), row) in power.iter_mut().zip(flags).zip(&self.file_row) {
            let charging = Some(flags & sample_flag::CHARGING != 0);
            // One that is unknown was left out before.
            let is_left_out = power.is_nan() && charging == Some(true);
            if is_left_out || is_charge(*power, f64::NAN, false, charging) {
                *power = f64::NAN;
                self.on_charger.push(*row);
            }
        }
    }

    /// Removes a column.
    pub fn drop_column(&mut self, column: Column) {
        self.columns[column as usize] = None;
    }

    /// Unknown columns of the file, which are not in the table.
    pub fn ignored_columns(&self) -> &[String] {
        &self.ignored_columns
    }

    /// Appends a value of `column` in SI units, for a table in SI units.
    pub(super) fn push_si(
        &mut self,
        cell: Cell<'_>,
        column: Column,
        value: f64,
    ) -> Result<(), TrialError> {
        check_value(cell, column.name(), column, value)?;
        self.push_checked(column, value);
        Ok(())
    }

    /// Appends the time of a new row.
    pub(crate) fn push_time(&mut self, cell: Cell<'_>, timestamp_s: f64) -> Result<(), TrialError> {
        if !is_time(timestamp_s) {
            let allowed = "a number of seconds within ±4e9";
            return Err(cell.refuse(TIME_NAMES[0], timestamp_s.to_string(), allowed));
        }
        self.push_any_time(cell, timestamp_s)
    }

    /// The same for a time in a unit that is not known yet.
    pub(super) fn push_any_time(&mut self, cell: Cell<'_>, time: f64) -> Result<(), TrialError> {
        if cell.row > MAX_FILE_ROWS {
            return Err(too_many_rows(cell.path, MAX_FILE_ROWS));
        }
        self.file_row.push(cell.row as u32);
        self.timestamp_s.push(time);
        Ok(())
    }

    /// Appends a value that [`check_value`] has passed, in the unit of the file.
    pub(super) fn push_checked(&mut self, column: Column, recorded: f64) {
        let values = self.columns[column as usize].get_or_insert_default();
        values.push(recorded);
    }

    /// A table for each recording in the file: another one begins where the time was set back, or
    /// the header came again.
    pub fn runs(mut self) -> Vec<Self> {
        let (starts, is_part) = (self.starts(), self.is_part);
        let (mut runs, mut taken) = (Vec::new(), 0);
        for (start, back_s) in starts {
            runs.push(Self { is_part, ..self.take_first(start - taken) });
            taken = start;
            self.appended = Some(Appended { row: self.file_row(0), back_s });
        }
        runs.push(self);
        runs
    }

    /// The first rows of appended recordings, and how far the time goes back there. A single row
    /// with another time begins none.
    fn starts(&self) -> Vec<(usize, Option<f64>)> {
        let times_s = &self.timestamp_s;
        let before = |header: &&u32| self.file_row.first().is_some_and(|first| *header < first);
        let mut headers = self.headers.iter().skip_while(before).peekable();
        let mut starts: Vec<(usize, Option<f64>)> = Vec::new();
        let (mut from, mut latest_s) = (0, times_s.first().copied().unwrap_or_default());
        for (row, time_s) in times_s.iter().copied().enumerate().skip(1) {
            let has_header = headers.next_if(|header| **header < self.file_row[row]).is_some();
            let back_s = latest_s - time_s;
            let next_s = times_s.get(row + 1).copied().unwrap_or(f64::NAN);
            let is_back = back_s > SET_BACK_S && next_s < latest_s;
            // Both have two rows that advance.
            if (is_back || has_header) && next_s > time_s && latest_s > times_s[from] {
                starts.push((row, is_back.then_some(back_s)));
                (from, latest_s) = (row, time_s);
            } else {
                latest_s = latest_s.max(time_s);
            }
        }
        let back = starts.iter().filter(|(_, back_s)| back_s.is_some()).count();
        if back > (times_s.len() / MAX_SET_BACK).max(2) {
            starts.retain(|(_, back_s)| back_s.is_none());
        }
        starts
    }

    /// Joins rows of which each has only some columns, as PlotJuggler writes those of several
    /// topics: rows with a reading stay, with the values of the others that are not too old.
    /// `by_product`: power is made of voltage and current. What was done, if anything was.
    pub(super) fn join_sparse(&mut self, by_product: bool) -> Option<String> {
        let reading = if by_product { Column::Current } else { Column::Power };
        let is_known = |column: Column, row: usize| value(&self.columns, column, row).is_some();
        let rows = self.rows();
        let readings = (0..rows).filter(|row| is_known(reading, *row)).count();
        let others = Column::ALL
            .into_iter()
            .filter(|column| *column != reading && !(by_product && *column == Column::Power));
        let is_apart = |column: Column| {
            let known = (0..rows).filter(|row| is_known(column, *row));
            let (count, shared) = known.fold((0, 0), |(count, shared), row| {
                (count + 1, shared + usize::from(is_known(reading, row)))
            });
            let few = readings.min(count);
            few >= MIN_SPARSE && shared as f64 <= MAX_SHARED * few as f64
        };
        let others: Vec<Column> = others.collect();
        if !others.iter().any(|column| is_apart(*column)) {
            return None;
        }
        let keeps: Vec<bool> = (0..rows).map(|row| is_known(reading, row)).collect();
        for column in others {
            let age_s = match column {
                Column::V | Column::Omega => COMMAND_AGE_S,
                _ => MEASURED_AGE_S,
            };
            let Some(values) = &mut self.columns[column as usize] else {
                continue;
            };
            let mut last = (f64::NEG_INFINITY, f64::NAN);
            for (value, time_s) in values.iter_mut().zip(&self.timestamp_s) {
                if !value.is_nan() {
                    last = (*time_s, *value);
                } else if (0.0..=age_s).contains(&(time_s - last.0)) {
                    *value = last.1;
                }
            }
        }
        let keep = |values: &mut Vec<f64>| {
            let mut kept = keeps.iter();
            values.retain(|_| kept.next() == Some(&true));
        };
        keep(&mut self.timestamp_s);
        self.columns.iter_mut().flatten().for_each(keep);
        let mut kept = keeps.iter();
        self.file_row.retain(|_| kept.next() == Some(&true));
        let [power, voltage, current] =
            [Column::Power, Column::Voltage, Column::Current].map(|column| column as usize);
        if by_product
            && let [Some(voltages), Some(currents)] =
                [voltage, current].map(|column| self.columns[column].clone())
        {
            let pairs = voltages.iter().zip(&currents);
            self.columns[power] = Some(pairs.map(|(mv, ma)| mv * ma / 1000.0).collect());
        }
        Some(format!(
            "each row has only some of the columns, as PlotJuggler writes them. The {readings} of {rows} rows \
             with a reading are kept. Commands are held for {COMMAND_AGE_S} s, other values for {MEASURED_AGE_S} s"
        ))
    }

    /// Puts rows in the order of time, if they are newest first. True if they were.
    pub(super) fn oldest_first(&mut self) -> bool {
        let steps = || self.timestamp_s.windows(2).map(|pair| pair[1] - pair[0]);
        let falls = steps().filter(|step_s| *step_s < 0.0).count();
        let rises = steps().filter(|step_s| *step_s > 0.0).count();
        let descends = !self.is_part && rises == 0 && falls >= MIN_FALLS;
        if descends {
            self.timestamp_s.reverse();
            self.file_row.reverse();
            self.columns.iter_mut().flatten().for_each(|values| values.reverse());
        }
        descends
    }

    /// True if a row of the file is among its rows, which are in the order of the file or against
    /// it.
    pub(super) fn has_file_row(&self, row: u32) -> bool {
        let is_turned = self.file_row.first() > self.file_row.last();
        let order = |other: &u32| if is_turned { row.cmp(other) } else { other.cmp(&row) };
        self.file_row.binary_search_by(order).is_ok()
    }

    /// Removes the first rows, which are then a table of their own.
    fn take_first(&mut self, rows: usize) -> Self {
        let others = self.columns.each_mut().map(|column| {
            let values = column.as_mut()?;
            Some(values.split_off(rows.min(values.len())))
        });
        let others = (self.file_row.split_off(rows), self.timestamp_s.split_off(rows), others);
        let first = self.clone();
        (self.file_row, self.timestamp_s, self.columns) = others;
        (self.unnamed_rows, self.left_out, self.appended) = (0, LeftOut::default(), None);
        self.understood.clear();
        Self { is_part: true, ..first }
    }

    /// The only table of a file.
    pub(super) fn only(mut tables: Vec<Self>) -> Result<Self, TrialError> {
        let Some(second) = tables.get(1) else {
            return Ok(tables.pop().unwrap_or_default());
        };
        let [first, found] =
            [&tables[0], second].map(|table| table.robot_name.as_deref().unwrap_or_default());
        let what = format!(
            "robot {found:?} after robot {first:?}. A trial holds one robot: `joulebus data \
             convert` splits the file"
        );
        let error = TrialError::new(&second.path, Fault::SecondRobot, what);
        Err(error.in_row(second.file_row.first().map_or(0, |row| *row as usize)))
    }
}

pub(super) fn too_many_rows(path: &Path, allowed: usize) -> TrialError {
    let what = format!(
        "more than {allowed} rows, which this verb has in memory at the same time. Split the \
         recording (`data check`, `train`, `eval`, `analyze` and `config init` read it in parts)"
    );
    TrialError::new(path, Fault::TooManyRows, what)
}

/// Samples carry f32: an overflow would arrive as infinity.
pub(super) fn check_value(
    cell: Cell<'_>,
    name: &str,
    column: Column,
    value: f64,
) -> Result<(), TrialError> {
    if value.is_nan() || (value as f32).is_finite() {
        return Ok(());
    }
    let allowed = "NaN, or a finite number within ±3.4e38 in SI units";
    Err(cell.refuse(name, column.recorded(value).to_string(), allowed))
}

/// Takes the tables of a file, until it wants no more.
pub(super) type Take<'a> = dyn FnMut(Table) -> ControlFlow<()> + 'a;

/// The tables of a file while it is read, one per robot, in the order in which they appear.
#[derive(Debug, Default)]
pub(super) struct Tables {
    tables: Vec<Table>,
    by_name: HashMap<String, usize>,
    rows: usize,
}

/// Rows of each robot that wait for the next part, so that the last one is a trial, too, and long
/// enough to be judged.
const KEPT_ROWS: usize = 4_096;

impl Tables {
    /// The rows in memory, if a part of the file is complete: nearly all of them, as tables of at
    /// most half a part.
    pub(super) fn complete(
        &mut self,
        path: &Path,
        in_memory: InMemory,
    ) -> Result<Option<Vec<Table>>, TrialError> {
        let InMemory { part_rows, max_rows } = in_memory;
        if self.rows > max_rows {
            return Err(too_many_rows(path, max_rows));
        }
        if self.rows <= part_rows {
            return Ok(None);
        }
        let most_rows = (part_rows / 2).max(1);
        let kept_rows = KEPT_ROWS.min(part_rows / (8 * self.tables.len().max(1))).max(2);
        let mut parts = Vec::new();
        for table in &mut self.tables {
            while table.rows() > 2 * kept_rows {
                let rows = most_rows.min(table.rows() - kept_rows);
                parts.push(table.take_first(rows));
                table.is_part = true;
            }
        }
        self.rows = self.tables.iter().map(Table::rows).sum();
        Ok(Some(parts))
    }

    /// Lines of the rows in memory, in order.
    pub(super) fn lines(&self) -> Vec<u32> {
        let mut lines: Vec<u32> =
            self.tables.iter().flat_map(|table| table.file_row.iter().copied()).collect();
        lines.sort_unstable();
        lines
    }

    /// The table of a row's robot. An empty name means none.
    pub(super) fn of(&mut self, cell: Cell<'_>, name: &str) -> Result<&mut Table, TrialError> {
        self.rows += 1;
        let at = match self.tables.len() {
            0 => self.add(cell, name)?,
            1 if name.is_empty() => {
                let table = &mut self.tables[0];
                table.unnamed_rows += usize::from(table.robot_name.is_some());
                0
            }
            1 if self.tables[0].robot_name.is_none() => {
                let table = &mut self.tables[0];
                table.unnamed_rows = table.rows();
                table.robot_name = Some(name.to_owned());
                self.by_name.insert(name.to_owned(), 0);
                0
            }
            _ => match self.by_name.get(name) {
                Some(at) => *at,
                None => self.add(cell, name)?,
            },
        };
        Ok(&mut self.tables[at])
    }

    fn add(&mut self, cell: Cell<'_>, name: &str) -> Result<usize, TrialError> {
        let at = self.tables.len();
        if at > 0 && (name.is_empty() || self.tables[0].unnamed_rows > 0) {
            let allowed = "in a file of several robots, a name in every row";
            return Err(cell.refuse(ROBOT_NAMES[0], name, allowed));
        }
        if at == MAX_ROBOTS {
            let what = format!("more than {MAX_ROBOTS} robots. Split the recording");
            return Err(TrialError::new(cell.path, Fault::TooManyRobots, what));
        }
        let robot_name = (!name.is_empty()).then(|| name.to_owned());
        self.tables.push(Table { path: cell.path.to_owned(), robot_name, ..Table::default() });
        if !name.is_empty() {
            self.by_name.insert(name.to_owned(), at);
        }
        Ok(at)
    }

    /// All tables, with the notes on the whole file. A file without rows gives an empty table.
    pub(super) fn finish(
        mut self,
        path: &Path,
        ignored_columns: &[String],
        no_final_line_break: bool,
    ) -> Vec<Table> {
        if self.tables.is_empty() {
            self.tables.push(Table { path: path.to_owned(), ..Table::default() });
        }
        for table in &mut self.tables {
            table.ignored_columns = ignored_columns.to_vec();
            table.no_final_line_break = no_final_line_break;
        }
        self.tables
    }
}

/// True if sums of two such times, and repetitions, fit into i64 nanoseconds.
pub(super) fn is_time(timestamp_s: f64) -> bool {
    (-MAX_TIMESTAMP_S..=MAX_TIMESTAMP_S).contains(&timestamp_s)
}

/// Enough for Unix seconds until the year 2096.
const MAX_TIMESTAMP_S: f64 = 4e9;
