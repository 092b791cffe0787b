//! Recordings that a computation takes: files, and trials in memory.

use std::path::PathBuf;

use joulebus_dataset::inspect::find;
use joulebus_dataset::trial::Trial;
use joulebus_eval::score::{Recording, open_recordings};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::error::of_file;
use crate::recordings::{Reading, refused_trial, trial};

/// Files, directories and patterns, then trials of Python.
#[derive(Debug, Default)]
pub(super) struct Inputs {
    paths: Vec<PathBuf>,
    trials: Vec<Trial>,
}

/// A trial as Python passes it: name, robot, columns.
type Given<'py> = (PathBuf, Option<String>, Bound<'py, PyDict>);

impl Inputs {
    /// The inputs in a list of paths and of trials.
    pub(super) fn new(given: &Bound<'_, PyAny>) -> PyResult<Self> {
        let mut found = Self::default();
        for given in given.try_iter()? {
            let given = given?;
            if let Ok((name, robot, columns)) = given.extract::<Given<'_>>() {
                found.trials.push(trial(&name, robot.as_deref().unwrap_or(""), &columns)?);
            } else {
                found.paths.push(given.extract()?);
            }
        }
        Ok(found)
    }

    /// The files of the paths. What is left out of directories is reported by `remark`.
    fn files(&self, remark: &mut impl FnMut(String)) -> PyResult<Vec<PathBuf>> {
        if self.paths.is_empty() {
            return Ok(Vec::new());
        }
        let found = find(&self.paths).map_err(|error| match &error {
            joulebus_dataset::inspect::FindError::Io { path, source } => of_file(path, source),
            error => PyValueError::new_err(error.to_string()),
        })?;
        found.remarks().for_each(remark);
        Ok(found.files)
    }

    /// Every trial, with all its rows in memory. Refuses implausible ones. `id` gives the robot's
    /// id for the live path.
    pub(super) fn recordings(
        self,
        reading: &Reading,
        id: fn(u32) -> u32,
        remark: impl FnMut(String),
    ) -> PyResult<Vec<Recording>> {
        self.open(reading, id, u64::MAX, remark)
    }

    /// Every trial. Of files, only so many rows are in memory.
    pub(super) fn open(
        self,
        reading: &Reading,
        id: fn(u32) -> u32,
        rows_in_memory: u64,
        mut remark: impl FnMut(String),
    ) -> PyResult<Vec<Recording>> {
        let files = self.files(&mut remark)?;
        let files: Vec<_> = (0..).map(id).zip(files).collect();
        let count = files.len() as u32;
        let read = open_recordings(&files, &reading.map, rows_in_memory);
        let mut recordings = read.map_err(|error| refused_trial(&error))?;
        let given = (count..).map(id).zip(self.trials);
        recordings.extend(given.map(|(id, trial)| Recording::new(id, trial)));
        let found = recordings.iter().flat_map(Recording::implausible);
        let short = recordings.iter().filter_map(Recording::short);
        reading.judge(found, short)?.into_iter().for_each(remark);
        Ok(recordings)
    }
}
