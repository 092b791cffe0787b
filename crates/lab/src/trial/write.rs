//! Trials from rows, and trials as the published table.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;

use super::table::{Cell, Column, ROBOT_NAMES, TIME_NAMES, Table};
use super::{Trial, TrialError};

/// A row that was not read from a trial's file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// Time, s.
    pub timestamp_s: f64,
    /// In the order of [`Column::ALL`], in SI units; NaN where nothing was recorded.
    pub values: [f64; Column::ALL.len()],
}

impl Trial {
    /// A trial of rows; `path` is what they come from, for messages.
    ///
    /// # Errors
    /// [`TrialError`]: a value that a sample could not carry, too many rows, or fewer than two
    /// times.
    pub fn from_rows(
        path: &Path,
        robot_name: &str,
        rows: impl IntoIterator<Item = Row>,
    ) -> Result<Self, TrialError> {
        let mut table = Table::default();
        for (number, row) in rows.into_iter().enumerate() {
            let cell = Cell {
                path,
                row: number + 1,
            };
            table.push_robot(cell, robot_name)?;
            table.push_time(cell, row.timestamp_s)?;
            for (column, value) in Column::ALL.into_iter().zip(row.values) {
                table.push_si(cell, column, value)?;
            }
        }
        Self::from_table(path, table)
    }

    /// Writes the trial as the published table: CSV with a header, compressed if the name ends in
    /// `.gz`. What was not recorded is `NaN`. The file must not exist.
    ///
    /// # Errors
    /// What the system said.
    pub fn write_csv(&self, path: &Path) -> io::Result<()> {
        let file = BufWriter::new(File::create_new(path)?);
        if path.extension().is_some_and(|extension| extension == "gz") {
            let mut zipped = GzEncoder::new(file, Compression::default());
            self.write_table(&mut zipped)?;
            zipped.finish()?.flush()
        } else {
            let mut file = file;
            self.write_table(&mut file)?;
            file.flush()
        }
    }

    fn write_table(&self, out: &mut impl Write) -> io::Result<()> {
        let names = Column::ALL.iter().map(|column| column.name());
        let names = names.collect::<Vec<_>>().join(",");
        writeln!(out, "{},{},{names}", ROBOT_NAMES[0], TIME_NAMES[0])?;
        let robot = self.robot_name.as_deref().unwrap_or("NaN");
        for (row, time_s) in self.timestamp_s.iter().enumerate() {
            write!(out, "{},{time_s}", quoted(robot))?;
            for column in Column::ALL {
                let value = self.value(column, row).unwrap_or(f64::NAN);
                write!(out, ",{}", column.recorded(value))?;
            }
            writeln!(out)?;
        }
        Ok(())
    }
}

/// A name as a CSV has it.
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
            values[Column::Current as usize] = if number % 9 == 0 {
                f64::NAN
            } else {
                step / 30.0
            };
            Row {
                timestamp_s: step / 30.0,
                values,
            }
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
                    assert_eq!(
                        again.column(column).is_some(),
                        trial.column(column).is_some()
                    );
                    continue;
                };
                for (read, written) in read.iter().zip(written) {
                    let close = (read - written).abs() <= 1e-12 * written.abs();
                    assert!(
                        close || read.is_nan() && written.is_nan(),
                        "{read} {written}"
                    );
                }
            }
        }
    }
}
