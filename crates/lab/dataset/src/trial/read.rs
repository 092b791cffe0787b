//! Reads files into tables.

use std::io::{BufReader, Cursor, Read};
use std::ops::ControlFlow;
use std::path::Path;

use joulebus_files::foreign;

use super::limits::{GZIP_MAGIC, InMemory, MCAP_MAGIC};
use super::names::ColumnMap;
use super::table::Take;
use super::text::empty;
use super::{Table, Trial, TrialError, capture, npy, text};

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
        let mut tables = Vec::new();
        let mut take = |table| {
            tables.push(table);
            ControlFlow::Continue(())
        };
        Self::read_in(path.as_ref(), map, InMemory::WHOLE, &mut take)?;
        Ok(tables)
    }

    /// Calls `take` with each table of a file, divided as by [`Table::runs`]. A file with more than
    /// [`MAX_ROWS`](super::MAX_ROWS) rows is read in parts: memory holds about so many rows of it,
    /// and a robot has several tables, one after another.
    ///
    /// # Errors
    /// Same as [`Table::read_mapped`], also after some tables were taken, and those of `take`.
    pub fn each<E: From<TrialError>>(
        path: impl AsRef<Path>,
        map: &ColumnMap,
        mut take: impl FnMut(Self) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut failed = None;
        Self::read_in(path.as_ref(), map, map.in_parts(), &mut |table| {
            failed = table.runs().into_iter().try_for_each(&mut take).err();
            match failed {
                None => ControlFlow::Continue(()),
                Some(_) => ControlFlow::Break(()),
            }
        })?;
        failed.map_or(Ok(()), Err)
    }

    fn read_in(
        path: &Path,
        map: &ColumnMap,
        in_memory: InMemory,
        take: &mut Take<'_>,
    ) -> Result<(), TrialError> {
        Self::read_as_recorded(path, map, in_memory, &mut |mut table| {
            map.apply_sign(&mut table);
            take(table)
        })
    }

    fn read_as_recorded(
        path: &Path,
        map: &ColumnMap,
        in_memory: InMemory,
        take: &mut Take<'_>,
    ) -> Result<(), TrialError> {
        let io = TrialError::io(path);
        let mut file = joulebus_files::open(path).map_err(io)?;
        let mut head = Vec::new();
        file.by_ref().take(foreign::HEAD_BYTES).read_to_end(&mut head).map_err(io)?;
        if head.is_empty() {
            return Err(empty(path));
        }
        let named_npy = joulebus_files::ends_in(path, "npy");
        if head.starts_with(crate::npy::MAGIC) || named_npy {
            npy::read(path, file, map, in_memory, take)
        } else if head.starts_with(MCAP_MAGIC) {
            capture::read(path, in_memory, take)
        } else {
            let file_bytes = file.metadata().map_err(io)?.len();
            let zipped = head.starts_with(GZIP_MAGIC).then_some(file_bytes);
            let whole = Cursor::new(head).chain(BufReader::new(file));
            text::read(path, (Box::new(whole), zipped, 1), map, in_memory, take)
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
    /// [`TrialError`] if no time advances.
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

    /// Same as [`Trial::read_robots`], with names for the columns of a CSV. A file to which another
    /// recording was appended has several trials of a robot ([`Table::runs`]).
    ///
    /// # Errors
    /// Same as [`Trial::read_robots`], and for a mapped column that the file lacks.
    pub fn read_mapped(path: impl AsRef<Path>, map: &ColumnMap) -> Result<Vec<Self>, TrialError> {
        let tables = Table::read_mapped(path, map)?;
        tables.into_iter().flat_map(Table::runs).map(Table::into_trial).collect()
    }

    /// Same as [`Trial::read_mapped`], of a CSV that has no file of its own. `name` is for errors.
    ///
    /// # Errors
    /// Same as [`Trial::read_mapped`].
    pub fn read_text(
        name: impl AsRef<Path>,
        text: impl Read + 'static,
        map: &ColumnMap,
    ) -> Result<Vec<Self>, TrialError> {
        let mut trials = Vec::new();
        let mut failed = None;
        let mut take = |mut table: Table| {
            map.apply_sign(&mut table);
            for run in table.runs() {
                match run.into_trial() {
                    Ok(trial) => trials.push(trial),
                    Err(error) => {
                        failed = Some(error);
                        return ControlFlow::Break(());
                    }
                }
            }
            ControlFlow::Continue(())
        };
        text::read(name.as_ref(), (Box::new(text), None, 0), map, InMemory::WHOLE, &mut take)?;
        failed.map_or(Ok(trials), Err)
    }

    /// Calls `take` with each trial of a file, of which memory holds a part at a time
    /// ([`Table::each`]).
    ///
    /// # Errors
    /// Same as [`Table::each`].
    pub fn each<E: From<TrialError>>(
        path: impl AsRef<Path>,
        map: &ColumnMap,
        mut take: impl FnMut(Self) -> Result<(), E>,
    ) -> Result<(), E> {
        Table::each(path, map, |table| take(table.into_trial()?))
    }
}
