//! Opens recordings, and reads those that are not in memory a few at a time.

use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};

use joulebus_dataset::trial::{ColumnMap, Stored, TrialError};
use rayon::prelude::*;

use super::recording::Recording;

/// Maximum number of rows of recordings that are read and evaluated at the same time, except for a
/// single longer one. A recording needs some 300 bytes a row, and its results wait for those before
/// it.
const MAX_ROWS_AT_ONCE: u64 = 1 << 19;

/// Rows of recordings in memory for the verbs that read more than memory holds: 150 MB.
pub const ROWS_IN_MEMORY: u64 = 1 << 19;

/// Reads recordings in parallel and returns them in the order of their files. Each has the id given
/// with its file. A file with several robots yields a recording for each. `map` names the columns
/// of CSV files.
///
/// # Errors
/// The error of the first file, in their order, that cannot be read.
pub fn read_recordings(
    files: &[(u32, PathBuf)],
    map: &ColumnMap,
) -> Result<Vec<Recording>, TrialError> {
    open_recordings(files, map, u64::MAX)
}

/// Same as [`read_recordings`], but only a bounded number of rows stays in memory. The others are
/// read again when they are needed ([`Recording::contents`]). Recordings of a file with several
/// robots always stay.
///
/// # Errors
/// Same as [`read_recordings`].
pub fn open_recordings(
    files: &[(u32, PathBuf)],
    map: &ColumnMap,
    rows_in_memory: u64,
) -> Result<Vec<Recording>, TrialError> {
    let places: Vec<(u32, Stored)> =
        files.iter().map(|(id, path)| (*id, Stored::new(path, map))).collect();
    let left = AtomicU64::new(rows_in_memory);
    let mut recordings = Vec::with_capacity(places.len());
    for group in in_groups(&places, |(_, place)| place.most_rows()) {
        let read = group.par_iter().map(|(id, place)| read(*id, place, &left));
        // Collected first, so that the error is always that of the first file.
        let read: Vec<Result<Vec<Recording>, TrialError>> = read.collect();
        for found in read {
            recordings.extend(found?);
        }
    }
    Ok(recordings)
}

fn read(id: u32, place: &Stored, left: &AtomicU64) -> Result<Vec<Recording>, TrialError> {
    let (mut recordings, mut waits) = (Vec::new(), None);
    place.each(|place, trial| {
        let rows = trial.rows() as u64;
        let room =
            left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(rows));
        let is_part = trial.is_part();
        let recording = Recording::new(id, trial);
        recordings.push(match (is_part, room) {
            (true, Err(_)) => recording.stored(place),
            (_, room) => {
                waits = room.err().map(|_| place);
                recording
            }
        });
    })?;
    let mut named = Vec::with_capacity(recordings.len());
    let several = recordings.len() > 1;
    // Keep all robots of a file: otherwise it would be read once for each.
    let mut waits = waits.filter(|_| recordings.len() == 1);
    for mut recording in recordings {
        if several {
            recording.name = format!("{} {}", recording.name, recording.robot);
        }
        named.push(match waits.take() {
            Some(place) => recording.stored(place),
            None => recording,
        });
    }
    Ok(named)
}

/// Consecutive groups of at most [`MAX_ROWS_AT_ONCE`] rows, or of one.
fn in_groups<T>(all: &[T], rows: impl Fn(&T) -> u64 + Copy) -> impl Iterator<Item = &[T]> {
    let mut rest = all;
    std::iter::from_fn(move || {
        let mut sum = 0_u64;
        let fits = rest.iter().take_while(|one| {
            sum = sum.saturating_add(rows(one));
            sum <= MAX_ROWS_AT_ONCE
        });
        let (group, after) = rest.split_at(fits.count().max(1).min(rest.len()));
        rest = after;
        (!group.is_empty()).then_some(group)
    })
}

/// Calls `take` with the index of each recording and the result of `of`, in order. Runs `of` in
/// parallel, as far as memory has room for the rows that it reads.
///
/// # Errors
/// The first error, in order, of `of` or of `take`.
pub(crate) fn each<T: Send, E: Send>(
    recordings: &[&Recording],
    of: impl Fn(usize) -> Result<T, E> + Sync,
    mut take: impl FnMut(usize, T) -> Result<(), E>,
) -> Result<(), E> {
    let places: Vec<usize> = (0..recordings.len()).collect();
    // Results need memory, too, so recordings that are already in memory count as well.
    for group in in_groups(&places, |at| recordings[*at].trial_rows() as u64) {
        // Collected first, so that the error is always the first one.
        let found: Vec<Result<T, E>> = group.par_iter().map(|at| of(*at)).collect();
        for (at, found) in group.iter().zip(found) {
            take(*at, found?)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::{MAX_ROWS_AT_ONCE, in_groups};

    #[test]
    fn groups_hold_all_in_order_and_at_most_the_rows_that_memory_has_room_for() {
        let all = [3, MAX_ROWS_AT_ONCE, 1, MAX_ROWS_AT_ONCE - 1, 1, u64::MAX, 2, 2];
        let groups: Vec<Vec<u64>> = in_groups(&all, |rows| *rows).map(<[u64]>::to_vec).collect();
        let expected: [&[u64]; 6] =
            [&[3], &[MAX_ROWS_AT_ONCE], &[1, MAX_ROWS_AT_ONCE - 1], &[1], &[u64::MAX], &[2, 2]];
        assert_eq!(groups, expected);
        assert_eq!(in_groups(&[], |rows: &u64| *rows).count(), 0);
    }
}
