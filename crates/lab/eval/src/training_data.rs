//! Rows of recordings to train on. They are read twice if memory does not hold them, and thinned if
//! there are more than a network of this size needs.

use std::num::NonZeroUsize;

use joulebus_dataset::rows::{Dataset, Row, RowOrigin};
use joulebus_dataset::split::{
    Assignment, MAX_STRETCH_ROWS, Split, SplitError, SplitSummary, Thinned, assign, assign_given,
    describe, median_period_s, resume,
};
use joulebus_dataset::trial::TrialError;

use crate::score::{Recording, sources};

/// Default maximum number of rows: 19 hours of a robot at 30 Hz. Training holds some 400 bytes of
/// each.
pub const MAX_ROWS: NonZeroUsize = NonZeroUsize::new(1 << 21).unwrap();

/// Errors of making a dataset.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum TrainingDataError {
    #[error(transparent)]
    Split(#[from] SplitError),
    #[error(transparent)]
    Trial(#[from] TrialError),
}

/// Assignment of recordings to the parts.
#[derive(Debug, Clone, Copy)]
pub enum Parts<'a> {
    /// By a split of the recordings.
    Split(&'a [Recording], Split),
    /// Given: training, validation, held out.
    Given([&'a [Recording]; 3]),
}

/// The rows of each part, at most about `max_rows` in all ([`Assignment::thin`]), and a
/// description of the split.
///
/// # Errors
/// [`TrainingDataError`].
pub fn training_data(
    parts: Parts<'_>,
    max_rows: usize,
) -> Result<(Dataset, SplitSummary), TrainingDataError> {
    let (recordings, assignment, described) = assigned(parts)?;
    let found: usize = assignment.summary.rows.iter().sum();
    let thinned = assignment.thin(max_rows);
    let taken: usize = thinned.rows.iter().sum();
    let (described, name) = match taken < found {
        false => (described, assignment.summary.name),
        true => {
            let thinned =
                format!("{taken} of {found} rows, in stretches of {MAX_STRETCH_ROWS} at most");
            let name = format!("{}; {thinned}", assignment.summary.name);
            (format!("{described}; {thinned}"), name)
        }
    };
    let [training, validation, held_out] = rows(&recordings, &thinned)?;
    let period_of = match parts {
        Parts::Split(all, _) => all,
        Parts::Given([training, ..]) => training,
    };
    let dataset = Dataset {
        training,
        validation,
        held_out,
        description: described,
        period_s: median_period_s(&sources(period_of)),
    };
    let summary = SplitSummary { rows: thinned.rows, name, ..assignment.summary };
    Ok((dataset, summary))
}

type Assigned<'a> = (Vec<&'a Recording>, Assignment, String);

/// The recordings in the order of their ranges, and how a model's file describes them.
fn assigned(parts: Parts<'_>) -> Result<Assigned<'_>, TrainingDataError> {
    match parts {
        Parts::Split(recordings, split) => {
            let infos = sources(recordings);
            let resume_at = |at: usize, cuts| -> Result<[usize; 2], TrainingDataError> {
                Ok(resume(&recordings[at].contents()?.rows, cuts))
            };
            let assignment = assign(&infos, split, resume_at)?;
            let described = format!("{}; {}", describe(&infos), split.origin());
            Ok((recordings.iter().collect(), assignment, described))
        }
        Parts::Given(parts) => {
            let infos = parts.map(sources);
            let assignment = assign_given(infos.each_ref().map(Vec::as_slice))?;
            let described = format!("{}; parts given individually", describe(&infos[0]));
            Ok((parts.into_iter().flatten().collect(), assignment, described))
        }
    }
}

fn rows(recordings: &[&Recording], thinned: &Thinned) -> Result<[Vec<Row>; 3], TrialError> {
    let mut parts = thinned.rows.map(Vec::with_capacity);
    let names = recordings.iter().map(|recording| (&*recording.name, &*recording.robot));
    let origins = RowOrigin::of_sources(names);
    for ((recording, ranges), origin) in recordings.iter().zip(&thinned.ranges).zip(origins) {
        if ranges.iter().all(Vec::is_empty) {
            continue;
        }
        let contents = recording.contents()?;
        for (part, ranges) in parts.iter_mut().zip(ranges) {
            for range in ranges {
                let rows = &contents.rows.rows[range.clone()];
                part.extend(rows.iter().map(|row| row.of(origin)));
            }
        }
    }
    Ok(parts)
}
