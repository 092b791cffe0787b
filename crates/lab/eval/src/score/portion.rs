//! The scores of some of an evaluation's recordings, to be merged into those of all.

use std::ops::ControlFlow;

use serde::{Deserialize, Serialize};

use super::blocks::{Block, Sums};
use super::common::Common;
use super::run::{Prepared, Reported, SumsOfAll};
use super::{Options, ScoreError, Subject};
use crate::energy::EnergyScores;
use crate::evaluate::{LivePool, LiveTrial};

/// Sums of some recordings of an evaluation. Sums of floats depend on their order. Each recording's
/// sums are therefore kept, and added in the order of the recordings once all are there, so that
/// the tables have the bits of a single run.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Portion {
    common: Common,
    recordings: Vec<OfRecording>,
}

/// Results of one recording.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct OfRecording {
    /// Its index.
    place: usize,
    evaluated: Sums,
    trained_on: Sums,
    /// The live path of each model.
    live: Vec<LiveTrial>,
    energy: Vec<EnergyScores>,
}

/// Reason that portions cannot be merged.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Misfit {
    /// The portions belong to different evaluations.
    Different,
    /// Results of a recording, by its index, are there twice, or are missing.
    Recording(usize),
    /// A table has another size than the evaluation's.
    Size,
}

/// Evaluates the recordings whose index satisfies `is_own`. Baselines are fitted on all recordings.
///
/// # Errors
/// Same as [`score`](super::score), except for rows that cannot be scored: only all portions
/// together show that.
pub fn score_portion(
    subject: Subject<'_>,
    options: &Options,
    is_own: impl Fn(usize) -> bool,
) -> Result<Portion, ScoreError> {
    let prepared = Prepared::new(subject, options)?;
    let places = (0..subject.recordings.len()).filter(|at| is_own(*at));
    let places: Vec<usize> = places.collect();
    let watch = |_| ControlFlow::Continue(());
    let mut recordings = Vec::with_capacity(places.len());
    let keep = |robot| LiveTrial::from(&robot);
    prepared.run(&places, watch, keep, |place, found| {
        recordings.push(OfRecording {
            place,
            evaluated: found.sums,
            trained_on: found.trained_on,
            live: found.live,
            energy: found.energy,
        });
        Ok(())
    })?;
    Ok(Portion { recordings, common: prepared.common })
}

impl Portion {
    /// Number of its recordings, and of all.
    pub fn recordings(&self) -> (usize, usize) {
        (self.recordings.len(), self.common.recordings.len())
    }

    /// Name of the platform.
    pub fn platform(&self) -> &str {
        &self.common.platform
    }

    /// The report of a single run, from the portions of the evaluation. The inner error is that of
    /// a single run.
    pub(crate) fn merged(portions: Vec<Self>) -> Result<Result<Reported, ScoreError>, Misfit> {
        let mut portions = portions.into_iter();
        let Some(Self { common, mut recordings }) = portions.next() else {
            return Ok(Err(ScoreError::NoRecording));
        };
        for other in portions {
            if !is_same(&common, &other.common) {
                return Err(Misfit::Different);
            }
            recordings.extend(other.recordings);
        }
        recordings.sort_by_key(|one| one.place);
        if let Some(place) = (0..common.recordings.len().max(recordings.len()))
            .find(|at| recordings.get(*at).is_none_or(|one| one.place != *at))
        {
            return Err(Misfit::Recording(place));
        }
        if !recordings.iter().all(|one| one.fits(&common)) {
            return Err(Misfit::Size);
        }
        Ok(report(&common, recordings))
    }
}

fn report(common: &Common, recordings: Vec<OfRecording>) -> Result<Reported, ScoreError> {
    let mut live = vec![LivePool::default(); common.models.len()];
    let mut sums = SumsOfAll::default();
    // All are there, in order.
    for (listed, one) in common.recordings.iter().zip(recordings) {
        for (pool, trial) in live.iter_mut().zip(&one.live) {
            pool.push(trial);
        }
        sums.push(listed, one.evaluated, one.trained_on, one.energy)?;
    }
    let (report, _) = sums.report(common)?;
    Ok(Reported { report, live })
}

/// To the bit: a NaN equals itself.
fn is_same(one: &Common, other: &Common) -> bool {
    let bytes = |common| postcard::to_allocvec(common).ok();
    bytes(one).is_some_and(|own| bytes(other).is_some_and(|other| own == other))
}

impl OfRecording {
    /// True if its tables have the sizes that the evaluation's names and horizons ask for.
    fn fits(&self, common: &Common) -> bool {
        let (models, names) = (common.models.len(), &common.names);
        let is_none_or = |found: usize, wanted: usize| found == 0 || found == wanted;
        let block = |block: &Block| {
            block.forecasters.len() == names.forecasters.len()
                && block.intervals.len() == names.intervals.len()
        };
        let sums = |sums: &Sums| {
            let open_loop = names.open_loop.len();
            sums.blocks.iter().all(block)
                && is_none_or(sums.residuals_w.len(), names.forecasters.len())
                && is_none_or(sums.horizons.len(), common.horizons.len())
                && sums
                    .horizons
                    .iter()
                    .all(|sums| sums.power.len() == open_loop && sums.energy.len() == open_loop)
        };
        names.models == models
            && names.open_loop.len() <= names.forecasters.len()
            && names.models + names.baselines <= names.forecasters.len()
            && sums(&self.evaluated)
            && sums(&self.trained_on)
            && is_none_or(self.live.len(), models)
            && is_none_or(self.energy.len(), models)
    }
}
