//! Two halves of the recordings: one to choose on, one to state on.

use joulebus_dataset::trial::Trial;
use joulebus_statistics::noise::Noise;
use joulebus_wire::Sample;

use super::play::ROBOT;
use super::request::CalibrateError;

/// Time of the first sample of every recording, because 0 means no stamp.
pub(super) const BASE_NS: u64 = 1_000_000_000;
/// Longer recordings are played in pieces of this length.
const PIECE_NS: u64 = 600_000_000_000;

/// Two halves of about the same length, each recording as a whole in one of them, drawn by a fixed
/// seed. A single recording is divided by its pieces.
///
/// # Errors
/// [`CalibrateError::Recordings`].
pub(super) fn halves(trials: &[Trial]) -> Result<[Vec<Vec<Sample>>; 2], CalibrateError> {
    let mut units: Vec<Vec<Vec<Sample>>> = trials.iter().map(pieces).collect();
    if units.len() == 1 {
        units = units.into_iter().flatten().map(|piece| vec![piece]).collect();
    }
    if units.len() < 2 {
        return Err(CalibrateError::Recordings { found: units.len() });
    }
    let mut noise = Noise::new(1, 0);
    for last in (1..units.len()).rev() {
        units.swap(last, noise.below(last + 1));
    }
    let (mut halves, mut rows) = ([Vec::new(), Vec::new()], [0, 0]);
    for unit in units {
        let half = usize::from(rows[1] < rows[0]);
        rows[half] += unit.iter().map(Vec::len).sum::<usize>();
        halves[half].extend(unit);
    }
    Ok(halves)
}

fn pieces(trial: &Trial) -> Vec<Vec<Sample>> {
    let samples = trial.to_samples(ROBOT, BASE_NS);
    let piece = |sample: &Sample| sample.stamp_ns.saturating_sub(BASE_NS) / PIECE_NS;
    let pieces = samples.chunk_by(|one, next| piece(one) == piece(next));
    pieces.map(<[Sample]>::to_vec).collect()
}
