//! The trials of a dataset as they were recorded, or on a grid.

use std::sync::Arc;

use joulebus_dataset::trial::{Resample, ResampleError};

use super::error::AnalyzeError;
use crate::score::{Contents, Recording, each};

/// Recordings on one grid. On another than their own they are resampled whenever they are needed.
pub(super) struct View<'a> {
    recordings: Vec<&'a Recording>,
    grid: Option<Resample>,
}

impl<'a> View<'a> {
    /// The recordings as they were made.
    pub(super) fn native(recordings: &'a [Recording]) -> Self {
        Self { recordings: recordings.iter().collect(), grid: None }
    }

    /// The recordings on a grid. Those that do not fit are left out.
    pub(super) fn on(recordings: &'a [Recording], grid: Resample) -> Self {
        Self { grid: Some(grid), ..Self::native(recordings) }
    }

    pub(super) fn recordings(&self) -> &[&'a Recording] {
        &self.recordings
    }

    /// Leaves out the recordings at the indices where `is_left_out` is true.
    pub(super) fn without(mut self, is_left_out: &[bool]) -> Self {
        let mut left_out = is_left_out.iter();
        self.recordings.retain(|_| !left_out.next().copied().unwrap_or_default());
        self
    }

    pub(super) fn contents(&self, at: usize) -> Result<Arc<Contents>, AnalyzeError> {
        let contents = self.recordings[at].contents()?;
        let Some(grid) = self.grid else {
            return Ok(contents);
        };
        let (trial, _) = contents.trial.resampled(grid)?;
        drop(contents);
        Ok(Arc::new(Contents::new(trial)))
    }

    /// Calls `take` with the result of `of` for each trial, in order.
    pub(super) fn each<T: Send>(
        &self,
        of: impl Fn(usize, &Contents) -> Result<T, AnalyzeError> + Sync,
        take: impl FnMut(usize, T) -> Result<(), AnalyzeError>,
    ) -> Result<(), AnalyzeError> {
        let of = |at: usize| of(at, &*self.contents(at)?);
        each(&self.recordings, of, take)
    }

    /// Same as `each`, with a reason for each trial that does not fit on the grid.
    pub(super) fn each_that_fits<T: Send>(
        &self,
        of: impl Fn(usize, &Contents) -> T + Sync,
        mut take: impl FnMut(usize, Result<T, String>),
    ) -> Result<(), AnalyzeError> {
        let of = |at: usize| match self.contents(at) {
            Ok(contents) => Ok(Ok(of(at, &contents))),
            Err(AnalyzeError::Resample(error)) if !matches!(error, ResampleError::Rate { .. }) => {
                Ok(Err(format!("{}: {error}", self.recordings[at].file())))
            }
            Err(error) => Err(error),
        };
        each(&self.recordings, of, |at, found| {
            take(at, found);
            Ok(())
        })
    }
}
