//! Reads files into tables.

use std::io::{BufReader, Cursor, Read};
use std::path::Path;

use joulebus_files::foreign;

use super::limits::{GZIP_MAGIC, MCAP_MAGIC};
use super::names::ColumnMap;
use super::{Table, Trial, TrialError, capture, npy, text};
use crate::archive;

impl Table {
    /// Reads the table of a file with one robot, as [`Trial::read`] does.
    ///
    /// # Errors
    /// [`TrialError`], like [`Trial::read`], but a time that never advances is accepted.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, TrialError> {
        Self::only(Self::read_robots(path)?)
    }

    /// Reads a file of one or several robots: one table each, in the order in which they appear.
    ///
    /// # Errors
    /// [`TrialError`], like [`Table::read`], but several robots are accepted if every row names its
    /// robot.
    pub fn read_robots(path: impl AsRef<Path>) -> Result<Vec<Self>, TrialError> {
        Self::read_mapped(path, &ColumnMap::default())
    }

    /// Same as [`Table::read_robots`], with names for the columns of a CSV, and the sign of the
    /// current in any format.
    ///
    /// # Errors
    /// Same as [`Table::read_robots`], and for a mapped column that the file lacks.
    pub fn read_mapped(path: impl AsRef<Path>, map: &ColumnMap) -> Result<Vec<Self>, TrialError> {
        let mut tables = Self::read_as_recorded(path.as_ref(), map)?;
        tables.iter_mut().for_each(|table| map.apply_sign(table));
        Ok(tables)
    }

    fn read_as_recorded(path: &Path, map: &ColumnMap) -> Result<Vec<Self>, TrialError> {
        if archive::is_listing(path) {
            return archive::tables(path);
        }
        let io = |source| TrialError::Io {
            path: path.to_owned(),
            source,
        };
        let mut file = joulebus_files::open(path).map_err(io)?;
        let mut head = Vec::new();
        file.by_ref()
            .take(foreign::HEAD_BYTES)
            .read_to_end(&mut head)
            .map_err(io)?;
        if head.is_empty() {
            return Err(TrialError::Empty {
                path: path.to_owned(),
            });
        }
        let named_npy = path.extension().is_some_and(|extension| extension == "npy");
        if head.starts_with(crate::npy::MAGIC) || named_npy {
            let file_bytes = file.metadata().map_err(io)?.len();
            let whole = head.as_slice().chain(BufReader::new(file));
            let mut tables = npy::read(path, whole, file_bytes)?;
            map.turn_as_configured(&mut tables);
            Ok(tables)
        } else if head.starts_with(MCAP_MAGIC) {
            capture::read(path)
        } else if head.starts_with(archive::MAGIC) {
            Ok(vec![archive::table(path)?.0])
        } else {
            let file_bytes = file.metadata().map_err(io)?.len();
            let zipped = head.starts_with(GZIP_MAGIC).then_some(file_bytes);
            let whole = Cursor::new(head).chain(BufReader::new(file));
            text::read(path, Box::new(whole), zipped, map)
        }
    }

    /// Same as [`Table::read`], with names for the columns of a CSV.
    ///
    /// # Errors
    /// Same as [`Table::read`], and for a mapped column that the file lacks.
    pub fn only_of(path: impl AsRef<Path>, map: &ColumnMap) -> Result<Self, TrialError> {
        Self::only(Self::read_mapped(path, map)?)
    }

    /// The trial in SI units.
    ///
    /// # Errors
    /// [`TrialError::NoPeriod`] if no time advances.
    pub fn into_trial(mut self) -> Result<Trial, TrialError> {
        for (column, values) in super::Column::ALL.into_iter().zip(&mut self.columns) {
            for value in values.iter_mut().flatten() {
                *value = column.si(*value);
            }
        }
        Trial::from_si(self)
    }
}

impl Trial {
    /// Reads the trials of a file of one or several robots, in the order in which they appear. Rows
    /// in [`TrialNotes`](super::TrialNotes) are the file's rows.
    ///
    /// # Errors
    /// [`TrialError`], like [`Trial::read`], but several robots are accepted if every row names its
    /// robot.
    pub fn read_robots(path: impl AsRef<Path>) -> Result<Vec<Self>, TrialError> {
        Self::read_mapped(path, &ColumnMap::default())
    }

    /// Same as [`Trial::read_robots`], with names for the columns of a CSV.
    ///
    /// # Errors
    /// Same as [`Trial::read_robots`], and for a mapped column that the file lacks.
    pub fn read_mapped(path: impl AsRef<Path>, map: &ColumnMap) -> Result<Vec<Self>, TrialError> {
        let tables = Table::read_mapped(path, map)?;
        tables.into_iter().map(Table::into_trial).collect()
    }
}
