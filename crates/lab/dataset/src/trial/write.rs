//! Trials from rows, and trials as the published table.

use std::io::{self, BufWriter, Write};
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;
use joulebus_files::ends_in;

use super::Trial;
use super::error::{Fault, TrialError};
use super::table::{CHARGING_NAME, Cell, Column, ROBOT_NAMES, TIME_NAMES, Table};
use crate::npy;
use joulebus_predictor::nan::canonical_f64;

/// A row that was not read from a trial's file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// Time, s.
    pub timestamp_s: f64,
    /// Values in the order of [`Column::ALL`], in SI units, NaN if not recorded.
    pub values: [f64; Column::ALL.len()],
}

impl Trial {
    /// A trial from rows. `path` names their origin in messages.
    ///
    /// # Errors
    /// [`TrialError`]: a value that a sample cannot represent, too many rows, or fewer than two
    /// times.
    pub fn from_rows(
        path: &Path,
        robot_name: &str,
        rows: impl IntoIterator<Item = Row>,
    ) -> Result<Self, TrialError> {
        Self::from_bag(path, robot_name, rows, &[], false)
    }

    /// The same of a bag, whose messages say which rows (from 0) are on the charger. `is_turned`:
    /// the sign of their current was turned.
    ///
    /// # Errors
    /// As [`Trial::from_rows`].
    pub fn from_bag(
        path: &Path,
        robot_name: &str,
        rows: impl IntoIterator<Item = Row>,
        on_charger: &[usize],
        is_turned: bool,
    ) -> Result<Self, TrialError> {
        let mut table = Table {
            is_turned,
            on_charger: on_charger.iter().map(|row| *row as u32 + 1).collect(),
            path: path.to_owned(),
            robot_name: (!robot_name.is_empty()).then(|| robot_name.to_owned()),
            ..Table::default()
        };
        for (number, row) in rows.into_iter().enumerate() {
            let cell = Cell { path, row: number + 1 };
            table.push_time(cell, row.timestamp_s)?;
            for (column, value) in Column::ALL.into_iter().zip(row.values) {
                table.push_si(cell, column, value)?;
            }
        }
        Self::from_si(table)
    }

    /// The trial in the units of files. A value read from a file with non-SI units may differ in
    /// the last bit. [`Table::read`] preserves it.
    pub fn to_table(&self) -> Table {
        let mut columns = self.table.columns.clone();
        for (column, values) in Column::ALL.into_iter().zip(&mut columns) {
            for value in values.iter_mut().flatten() {
                *value = column.recorded(*value);
            }
        }
        Table {
            path: self.table.path.clone(),
            robot_name: self.table.robot_name.clone(),
            file_row: self.table.file_row.clone(),
            on_charger: self.table.on_charger.clone(),
            timestamp_s: self.table.timestamp_s.clone(),
            columns,
            ..Table::default()
        }
    }

    /// Writes the trial as the published table: CSV with a header and all columns, compressed if
    /// the name ends in `.gz`. Values that were not recorded are `NaN`. The file must not exist.
    ///
    /// # Errors
    /// The operating system's error.
    pub fn write_csv(&self, path: &Path) -> io::Result<()> {
        let mut table = self.to_table();
        for values in &mut table.columns {
            values.get_or_insert_with(|| vec![f64::NAN; self.rows()]);
        }
        let is_zipped = ends_in(path, "gz");
        create(
            path,
            |file| {
                if is_zipped { table.write_zipped(file) } else { table.write_text(file) }
            },
        )
    }
}

/// Format of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// The published array, float64.
    Npy,
    /// CSV with a header.
    Csv,
    /// CSV compressed by gzip.
    CsvGz,
}

impl Form {
    /// All formats.
    pub const ALL: [Self; 3] = [Self::Npy, Self::Csv, Self::CsvGz];

    /// The file name extension.
    pub const fn ending(self) -> &'static str {
        match self {
            Self::Npy => ".npy",
            Self::Csv => ".csv",
            Self::CsvGz => ".csv.gz",
        }
    }

    /// The format of a file name's extension, if it is one of these.
    pub fn new(path: &Path) -> Option<Self> {
        Self::ALL.into_iter().find(|form| ends_in(path, &form.ending()[1..]))
    }
}

impl Table {
    /// Writes the table in the format given by the file name's extension. The file must not exist
    /// and is written atomically. Reading it gives the same bits, except for the payload of NaNs.
    /// Columns without values may be missing. A CSV with rows on the charger has a column that says
    /// which.
    ///
    /// # Errors
    /// [`TrialError`]: what the format cannot represent is refused, never dropped, and an existing
    /// file is not overwritten.
    pub fn write(&self, path: &Path) -> Result<(), TrialError> {
        let written = match Form::new(path) {
            None => {
                let what = "names of recordings end in .npy, .csv or .csv.gz";
                return Err(TrialError::new(path, Fault::Ending, what));
            }
            Some(Form::Csv) => create(path, |file| self.write_text(file)),
            Some(Form::CsvGz) => create(path, |file| self.write_zipped(file)),
            Some(Form::Npy) => {
                let robot = self.check_array(path)?;
                create(path, |file| self.write_array(file, robot))
            }
        };
        written.map_err(TrialError::io(path))
    }

    fn write_text(&self, out: &mut dyn Write) -> io::Result<()> {
        let columns = Column::ALL
            .into_iter()
            .filter_map(|column| match self.column(column) {
                // The reader requires it, so a table without rows has it as well.
                None if column == Column::Power => Some((column, &[][..])),
                values => Some((column, values?)),
            })
            .collect::<Vec<_>>();
        let names = columns.iter().map(|(column, _)| column.name());
        let names = [ROBOT_NAMES[0], TIME_NAMES[0]].into_iter().chain(names);
        // Otherwise a power that was left out would be one that is missing.
        let charging = (!self.on_charger.is_empty()).then_some(CHARGING_NAME);
        let names = names.chain(charging);
        writeln!(out, "{}", names.collect::<Vec<_>>().join(","))?;
        let robot = quoted(self.robot_name().unwrap_or("NaN"));
        for (row, time_s) in self.timestamp_s.iter().enumerate() {
            write!(out, "{robot},{time_s}")?;
            for (_, values) in &columns {
                write!(out, ",{}", values.get(row).copied().unwrap_or(f64::NAN))?;
            }
            if charging.is_some() {
                write!(out, ",{}", u8::from(self.is_on_charger(row)))?;
            }
            writeln!(out)?;
        }
        Ok(())
    }

    fn write_zipped(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut zipped = BufWriter::new(GzEncoder::new(out, Compression::default()));
        self.write_text(&mut zipped)?;
        zipped.into_inner()?.finish()?.flush()
    }

    /// Checks that the array layout can represent the table. Returns the robot as the number
    /// stored.
    fn check_array(&self, path: &Path) -> Result<f64, TrialError> {
        if self.rows() < 2 {
            let what = format!("{} rows. An array needs at least 2, write CSV", self.rows());
            return Err(TrialError::new(path, Fault::TooFewRows, what));
        }
        let robot = match self.robot_name() {
            None => f64::NAN,
            Some(name) => {
                let number = name.parse::<f64>().ok();
                let number = number.filter(|number| number.is_finite());
                let number = number.filter(|number| number.to_string() == name);
                number.ok_or_else(|| {
                    let what = format!(
                        "the robot's name is {name:?}, but an array holds numbers, allowed: a \
                         numeric name that reads back as it is, such as 7"
                    );
                    TrialError::new(path, Fault::RobotName, what)
                })?
            }
        };
        let outside = Column::ALL[Column::LAYOUT..]
            .iter()
            .filter(|column| {
                let values = self.column(**column).unwrap_or_default();
                values.iter().any(|value| !value.is_nan())
            })
            .map(|column| column.name())
            .collect::<Vec<_>>();
        if outside.is_empty() {
            return Ok(robot);
        }
        let what = format!(
            "the array layout has no columns {}, which hold values. Drop them by name, or write CSV",
            outside.join(" ")
        );
        Err(TrialError::new(path, Fault::NoSuchColumns, what))
    }

    fn write_array(&self, out: &mut dyn Write, robot: f64) -> io::Result<()> {
        let columns = Column::ALL[..Column::LAYOUT].iter();
        let columns = columns.map(|column| self.column(*column)).collect::<Vec<_>>();
        out.write_all(&npy::header("<f8", &[self.rows(), 2 + Column::LAYOUT]))?;
        for (row, time_s) in self.timestamp_s.iter().enumerate() {
            out.write_all(&robot.to_le_bytes())?;
            out.write_all(&time_s.to_le_bytes())?;
            for values in &columns {
                let value = values.and_then(|values| values.get(row).copied());
                let value = canonical_f64(value.unwrap_or(f64::NAN));
                out.write_all(&value.to_le_bytes())?;
            }
        }
        out.flush()
    }
}

/// Writes a file that must not exist, as a whole.
fn create(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    joulebus_files::create(path, |file| {
        let mut buffered = BufWriter::new(file);
        write(&mut buffered)?;
        buffered.flush()
    })
}

/// A name quoted for CSV.
fn quoted(name: &str) -> String {
    if name.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", name.replace('"', "\"\""))
    } else {
        name.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::{Column, Row, Trial};

    #[test]
    fn what_is_written_is_read_again() {
        let rows = (0..50).map(|number| {
            let step = f64::from(number);
            let mut values = [f64::NAN; Column::ALL.len()];
            values[Column::V as usize] = 0.1 * step.sin();
            values[Column::Power as usize] = 3.0 + step / 7.0;
            values[Column::Voltage as usize] = 11.1;
            values[Column::Current as usize] = if number % 9 == 0 { f64::NAN } else { step / 30.0 };
            Row { timestamp_s: step / 30.0, values }
        });
        let trial = Trial::from_rows(Path::new("rows"), "a, \"b\"", rows).expect("rows are sound");
        let directory = tempfile::tempdir().expect("a directory");
        for name in ["a.csv", "a.csv.gz"] {
            let path = directory.path().join(name);
            trial.write_csv(&path).expect("it can be written");
            assert!(trial.write_csv(&path).is_err(), "it would be overwritten");
            let again = Trial::read(&path).expect("it can be read");
            assert_eq!(again.robot_name(), trial.robot_name());
            assert_eq!(again.timestamp_s(), trial.timestamp_s());
            assert_eq!(again.notes().missing_columns, trial.notes().missing_columns);
            for column in Column::ALL {
                let (Some(read), Some(written)) = (again.column(column), trial.column(column))
                else {
                    assert_eq!(again.column(column).is_some(), trial.column(column).is_some());
                    continue;
                };
                for (read, written) in read.iter().zip(written) {
                    let close = (read - written).abs() <= 1e-12 * written.abs();
                    assert!(close || read.is_nan() && written.is_nan(), "{read} {written}");
                }
            }
        }
    }
}
