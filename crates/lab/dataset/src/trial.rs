//! Recorded trials: reading them, notes on their quality, and their samples.
//!
//! A trial is the recording of one robot in one run. Its file has the published layout as a NumPy
//! array, or the same table as CSV with a header, plain or compressed by gzip. Or it is a capture
//! of joulebus, with the samples of each robot. Units are converted here, once: everything inside
//! is SI, and values that were not recorded are NaN or a missing column. A [`Table`] holds the same
//! in the units of the file, for writing it again.

mod bag;
mod capture;
mod error;
mod fleet;
mod layout;
mod limits;
mod meter;
mod names;
mod note;
mod npy;
mod numbers;
mod proposal;
mod read;
mod resample;
mod sample;
mod stored;
mod table;
mod text;
mod times;
mod write;

use std::path::Path;

use joulebus_plausibility::{Known, Observation, Quantity as Judged, TimeUnit, on_charger};

pub use bag::{BagTrial, BagTrialError};
pub use capture::is_capture;
pub use error::{Fault, TrialError};
pub use fleet::{Playback, TrialFleet, TrialFleetError};
pub use limits::MAX_ROWS;
pub use names::{ColumnMap, MapError, MappedColumn, Quantity, column_names};
pub use note::{Gap, TrialNotes};
pub use resample::{Method, Resample, ResampleError, Resampled};
pub use stored::Stored;
pub use table::{Column, LeftOut, SourceColumn, Table};
pub use write::{Form, Row};

pub(crate) use capture::try_is_capture;
pub(crate) use names::command_option;

use table::{Appended, Columns};

/// The columns that are judged.
pub(crate) const JUDGED: [(Judged, Column); 6] = [
    (Judged::Power, Column::Power),
    (Judged::Voltage, Column::Voltage),
    (Judged::Current, Column::Current),
    (Judged::Soc, Column::Soc),
    (Judged::V, Column::V),
    (Judged::Omega, Column::Omega),
];

/// One robot's recorded run: at least two rows, in file order, in SI units.
#[derive(Debug, Clone)]
pub struct Trial {
    /// Its rows, in SI units.
    table: Table,
    offset_ns: Vec<i64>,
    period_ns: u64,
    notes: TrialNotes,
}

impl Trial {
    /// Reads a trial from a file.
    ///
    /// The format is detected from the first bytes: a NumPy array of shape (n, 11) with floats of 4
    /// or 8 bytes in either byte order and either memory order; gzip with CSV in it; CSV. CSV
    /// columns are found by name, in any order ([`column_names`]). Time and power are required, or
    /// voltage and current instead of power. `NaN` and an empty field mean "not recorded". A
    /// capture (MCAP) gives the rows whose samples it holds.
    ///
    /// # Errors
    /// [`TrialError`] names the file and, where there is one, row and column, with what was found
    /// and what is allowed. A truncated file is an error. A CSV that only lacks its final newline
    /// is read, and [`TrialNotes::no_final_line_break`] is set.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, TrialError> {
        Table::read(path)?.into_trial()
    }

    /// The trial of a table whose values are already in SI units.
    fn from_si(mut table: Table) -> Result<Self, TrialError> {
        let mut on_charger = std::mem::take(&mut table.on_charger);
        on_charger.retain(|row| table.has_file_row(*row));
        let by_sign = leave_out_charging(&table.timestamp_s, &mut table.columns);
        on_charger.extend(by_sign.into_iter().filter_map(|row| table.file_row.get(row).copied()));
        on_charger.sort_unstable();
        on_charger.dedup();
        table.on_charger = on_charger;
        for column in &mut table.columns {
            if column.as_ref().is_some_and(|values| values.iter().all(|value| value.is_nan())) {
                *column = None;
            }
        }
        let offset_ns = note::offsets_ns(&table.timestamp_s);
        let Some(period_ns) = note::median_step_ns(&offset_ns) else {
            let what = format!(
                "{} rows, and no timestamp advances. A trial needs two rows at increasing times",
                table.rows()
            );
            return Err(TrialError::new(&table.path, Fault::NoPeriod, what));
        };
        let notes = note::take(&offset_ns, period_ns, &mut table);
        let mut trial = Self { table, offset_ns, period_ns, notes };
        let charged = (0..trial.rows()).filter(|row| trial.is_on_charger(*row)).count();
        trial.notes.missing_readings -= charged;
        Ok(trial)
    }

    /// The file that the trial was read from.
    pub fn path(&self) -> &Path {
        &self.table.path
    }

    /// The robot's name as recorded, if any: text in a CSV, a number in an array.
    pub fn robot_name(&self) -> Option<&str> {
        self.table.robot_name.as_deref()
    }

    /// The file's row (from 1, the line of a CSV) of row `row` (from 0).
    pub fn file_row(&self, row: usize) -> usize {
        self.table.file_row(row)
    }

    /// The number of row `row` (from 0) among the rows of its file, from 1. A CSV's header, and empty
    /// lines, are none.
    pub fn data_row(&self, row: usize) -> usize {
        self.table.data_row(row)
    }

    /// Rows. At least two.
    pub fn rows(&self) -> usize {
        self.table.rows()
    }

    /// Time of each row as recorded, s. Finite, not always increasing (see [`TrialNotes`]).
    pub fn timestamp_s(&self) -> &[f64] {
        &self.table.timestamp_s
    }

    /// Time of each row after the first one, rounded to whole ns.
    pub fn offset_ns(&self) -> &[i64] {
        &self.offset_ns
    }

    /// One value per row in the SI unit of the [`Column`], NaN if it was not recorded. `None` if
    /// the column is missing or all NaN.
    pub fn column(&self, column: Column) -> Option<&[f64]> {
        self.table.columns[column as usize].as_deref()
    }

    /// True if the reading of `row` (from 0) equals the previous row's: power, voltage and current,
    /// to the bit.
    pub fn is_held(&self, row: usize) -> bool {
        table::is_held(&self.table.columns, row)
    }

    /// True if the power of `row` (from 0) is unknown because the robot is on its charger: the file
    /// says so, or the current flows into the battery.
    pub fn is_on_charger(&self, row: usize) -> bool {
        let flows_in = || self.value(Column::Current, row).is_some_and(|current_a| current_a < 0.0);
        self.value(Column::Power, row).is_none() && (self.is_said_to_charge(row) || flows_in())
    }

    /// True if the file says so, or the sign of power over seconds.
    fn is_said_to_charge(&self, row: usize) -> bool {
        self.table.is_on_charger(row)
    }

    /// Median step between rows whose time advances, ns. At least 1.
    pub fn period_ns(&self) -> u64 {
        self.period_ns
    }

    /// The columns of a CSV that were read. Empty for other formats, which state their units.
    pub fn sources(&self) -> &[SourceColumn] {
        &self.table.sources
    }

    /// The name of a column in the file.
    pub(crate) fn name_of(&self, column: Column) -> &str {
        match self.table.sources.iter().find(|source| source.column == column) {
            Some(source) => &source.name,
            // Power of voltage and current has no column.
            None if column == Column::Power && !self.table.sources.is_empty() => "power",
            None => column.name(),
        }
    }

    /// The name of a CSV's column with the time as a number.
    pub(crate) fn time_name(&self) -> Option<&str> {
        self.table.time_name.as_deref()
    }

    /// True if the sign of the current was turned when it was read.
    pub(crate) const fn is_turned(&self) -> bool {
        self.table.is_turned
    }

    /// True if other trials of its file have further rows of the robot, because the file has too
    /// many for one ([`Trial::each`]).
    pub const fn is_part(&self) -> bool {
        self.table.is_part
    }

    /// Position of another recording that was appended to its file, if any.
    pub(crate) const fn appended(&self) -> Option<Appended> {
        self.table.appended
    }

    /// A column of few words by which the rows of its file alternate, as those of several sources.
    pub(crate) fn apart(&self) -> Option<&str> {
        self.table.apart.as_deref()
    }

    /// Its rows as they are judged: in SI units, with times since the first.
    pub(crate) fn observations(&self) -> impl Iterator<Item = Observation> + Clone + '_ {
        let value = |column, row: usize| self.column(column).map_or(f64::NAN, |values| values[row]);
        let first_s = self.table.timestamp_s.first().copied().unwrap_or_default();
        self.table.timestamp_s.iter().enumerate().map(move |(row, time_s)| Observation {
            v_mps: value(Column::V, row),
            omega_radps: value(Column::Omega, row),
            v_measured_mps: value(Column::VMeasured, row),
            omega_measured_radps: value(Column::OmegaMeasured, row),
            power_w: value(Column::Power, row),
            voltage_v: value(Column::Voltage, row),
            current_a: value(Column::Current, row),
            soc: value(Column::Soc, row),
            ..Observation::at(time_s - first_s)
        })
    }

    /// What is known of its readings beforehand: where their units and times are from.
    pub(crate) fn known(&self) -> Known {
        let time = match (&self.table.time_name, self.table.states_time_unit) {
            _ if self.is_array() => TimeUnit::Unstated,
            (None, _) => TimeUnit::Certain,
            (Some(_), true) => TimeUnit::Named,
            (Some(_), false) => TimeUnit::Unstated,
        };
        let mut known = Known::default().whole().timed(time).turned(self.table.is_turned);
        for (quantity, column) in JUDGED {
            let source = self.table.sources.iter().find(|source| source.column == column);
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
    pub(crate) fn is_array(&self) -> bool {
        self.table.sources.is_empty() && joulebus_files::ends_in(&self.table.path, "npy")
    }

    /// Quality notes on the trial.
    pub fn notes(&self) -> &TrialNotes {
        &self.notes
    }

    /// The value at `row`, if it was recorded.
    fn value(&self, column: Column, row: usize) -> Option<f64> {
        table::value(&self.table.columns, column, row)
    }
}

/// Makes the power unknown in rows in which its sign shows that the robot is on its charger.
fn leave_out_charging(timestamp_s: &[f64], columns: &mut Columns) -> Vec<usize> {
    let value = |column: Column, row: usize| table::value(columns, column, row).unwrap_or(f64::NAN);
    let found = on_charger(timestamp_s.len(), |row| Observation {
        v_mps: value(Column::V, row),
        omega_radps: value(Column::Omega, row),
        v_measured_mps: value(Column::VMeasured, row),
        omega_measured_radps: value(Column::OmegaMeasured, row),
        power_w: value(Column::Power, row),
        ..Observation::at(timestamp_s[row])
    });
    for row in &found {
        if let Some(power) = &mut columns[Column::Power as usize] {
            power[*row] = f64::NAN;
        }
    }
    found
}
